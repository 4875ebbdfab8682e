import assert from "node:assert/strict";
import { test } from "node:test";
import { fuzz } from "./fuzz.mjs";

test("2,000 damaged files", async () => {
  const { results } = await fuzz(2000, 1);
  assert.ok(Object.keys(results).length >= 8, JSON.stringify(results)); // damage of many kinds
});
