// A mesh of a file as GLB, to measure it: node bench/mesh.mjs FILE.cndhf OPTIONS OUT.glb && cndhf-compare INPUT OUT.glb
// OPTIONS: those of toMesh, in JSON.
import { readFileSync, writeFileSync } from "node:fs";
import { toGlb } from "../dist/glb.js";
import { decode } from "../dist/index.js";

const [, , file, options, out] = process.argv;
const mesh = await (await decode(readFileSync(file))).toMesh(JSON.parse(options));
writeFileSync(out, toGlb(mesh));
console.log(`${mesh.index.length / 3} triangles`);
