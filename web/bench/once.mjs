// One run of bench/draco.mjs in a process of its own, which loads nothing else: node bench/once.mjs FILE OPTIONS
// OPTIONS: those of toMesh in JSON; null for a file of Draco's.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { draco, ours } from "./decoders.mjs";

const [, , file, options] = process.argv;
const data = new Uint8Array(readFileSync(file));
const start = performance.now();
const { triangles, decoded } = await (options === "null"
  ? draco(await createRequire(import.meta.url)("draco3d/draco_decoder_nodejs.js")({}), data)
  : ours(await import("../dist/index.js"), data, JSON.parse(options)));
const end = performance.now();
console.log(JSON.stringify({ milliseconds: end - start, decoded: (decoded ?? end) - start, triangles }));
