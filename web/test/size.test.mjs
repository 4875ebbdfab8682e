// Budgets of bytes, and what is in the package.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

const DIST = new URL("../dist/", import.meta.url);
const read = (path) => readFileSync(new URL(path, DIST));
const chunk = (name) => `chunks/${readdirSync(new URL("chunks/", DIST)).find((f) => f.startsWith(name) && f.endsWith(".js"))}`;

for (const [what, path, most] of [
  ["the decoder of both kinds, queries, and meshes of surfaces", "index.js", 12_000],
  ["marching cubes, loaded by the first mesh of double height fields", chunk("isosurface"), 3_500],
  ["zstd, loaded by the first file of preset paper", chunk("weights"), 3_800],
  ["what belongs to three.js", "three.js", 5_000],
  ["the GLB writer", "glb.js", 1_000],
  ["the worker", "worker.js", 300],
]) {
  test(`${what}: at most ${most} bytes gzipped`, (t) => {
    const size = gzipSync(read(path), { level: 9 }).length;
    t.diagnostic(`${size} bytes`);
    assert.ok(size <= most, `${path} has ${size} bytes gzipped`);
  });
}

test("nothing else is loaded at first", () => {
  const code = read("index.js").toString();
  assert.deepEqual(code.match(/\bimport\s*[{*"']/g), null);
  assert.equal(code.match(/\bimport\(/g).length, 2);
  assert.deepEqual(readdirSync(new URL("chunks/", DIST)).filter((f) => f.endsWith(".js")).length, 2);
});

test("the viewer: one page, at most 700,000 bytes, that loads nothing", (t) => {
  const page = read("viewer.html");
  t.diagnostic(`${page.length} bytes`);
  assert.ok(page.length <= 700_000, String(page.length));
  assert.doesNotMatch(page.toString(), /<script[^>]+src=|<link[^>]+stylesheet|@import|\bfrom\s*"https?:/);
});

test("the Python package has the same page", () => {
  const there = readFileSync(new URL("../../cndhf_codec/viewer/viewer.html", import.meta.url));
  assert.ok(read("viewer.html").equals(there), "cndhf_codec/viewer/viewer.html is old: run npm run viewer in web/");
});

test("the package holds what it names", () => {
  const folder = fileURLToPath(new URL("..", import.meta.url));
  const out = execFileSync("npm", ["pack", "--dry-run", "--json", "--ignore-scripts"], { cwd: folder, encoding: "utf8" });
  const files = JSON.parse(out)[0].files.map(({ path }) => path);
  const wanted = ["LICENSE", "README.md", "package.json", "dist/index.js", "dist/three.js", "dist/worker.js", "dist/glb.js",
    "dist/viewer.html", "dist/types/index.d.ts", "dist/types/three/index.d.ts", "dist/types/glb.d.ts"];
  for (const path of wanted) assert.ok(files.includes(path), `${path} is missing`);
  for (const path of files) assert.match(path, /^(dist\/|LICENSE|README\.md|package\.json)/);
});
