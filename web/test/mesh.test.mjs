// Meshes: closed, outward, on the surface; and the cases that have none.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { decode, OptionError, SurfaceError } from "../dist/index.js";
import { bytesOf, vector } from "./files.mjs";

/** Volume, and whether each edge is passed once in either direction. */
function solid({ positions: p, index }) {
  let volume = 0;
  const edges = new Map();
  for (let f = 0; f < index.length; f += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => [0, 1, 2].map((j) => p[3 * index[f + k] + j]));
    volume += (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])) / 6;
    for (let k = 0; k < 3; k++) {
      const [v, w] = [index[f + k], index[f + ((k + 1) % 3)]];
      const key = `${Math.min(v, w)} ${Math.max(v, w)}`;
      const [ahead, back] = edges.get(key) ?? [0, 0];
      edges.set(key, v < w ? [ahead + 1, back] : [ahead, back + 1]);
    }
  }
  return { volume, closed: [...edges.values()].every(([ahead, back]) => ahead === 1 && back === 1) };
}

const DHFS = ["examples/bracket.cndhf", "tests/golden/encoded.cndhf", "tests/golden/by-hand.cndhf",
  vector("dhf-rans"), vector("dhf-zstd"), vector("dhf-rans-rising")];

for (const path of DHFS) {
  test(`marching cubes of ${path}`, async () => {
    const model = await decode(bytesOf(path));
    for (const resolution of [8, 33, 64]) {
      let mesh;
      try {
        mesh = await model.toMesh({ resolution });
      } catch (error) {
        if (error instanceof SurfaceError && resolution === 8) continue; // thinner than a cell
        throw error;
      }
      const { volume, closed } = solid(mesh);
      assert.ok(closed, `resolution ${resolution}`);
      assert.ok(volume > 0);
      const cell = model.scale / resolution;
      const points = mesh.positions.map((x, i) => x + mesh.origin[i % 3]);
      const f = model.implicit(points).map(Math.abs).sort();
      if (resolution > 8) assert.ok(f[f.length >> 1] < 0.3 * cell, `${f[f.length >> 1]} of ${cell}`);
      for (let i = 0; i < mesh.normals.length; i += 3) {
        assert.ok(Math.abs(Math.hypot(...mesh.normals.subarray(i, i + 3)) - 1) < 1e-5);
      }
      // Most normals agree with the triangles.
      let same = 0;
      for (let t = 0; t < mesh.index.length; t += 3) {
        const [a, b, c] = [0, 1, 2].map((k) => mesh.positions.subarray(3 * mesh.index[t + k], 3 * mesh.index[t + k] + 3));
        const [u, v] = [b.map((x, k) => x - a[k]), c.map((x, k) => x - a[k])];
        const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        same += n.reduce((sum, x, k) => sum + x * mesh.normals[3 * mesh.index[t] + k], 0) > 0 ? 1 : 0;
      }
      if (resolution > 8) assert.ok(same / (mesh.index.length / 3) > 0.85, `${same} of ${mesh.index.length / 3}`);
    }
  });
}

test("surfaces are closed and face outward", async () => {
  for (const name of ["smooth", "all-sharp", "creases"]) {
    const model = await decode(bytesOf(vector(`surface-${name}`)));
    for (const level of [0, 1, 2]) {
      const mesh = await model.toMesh({ level });
      if (name === "smooth") assert.ok(solid(mesh).closed);
      assert.ok(solid({ ...mesh, positions: mesh.positions.map((x, i) => x - model.centre[i % 3]) }).volume > 0);
    }
  }
});

/** A mesh whose vertices at one place are one: on a sharp edge there is one per side. */
function welded({ positions, index }) {
  const first = new Map();
  const at = (v) => positions.slice(3 * v, 3 * v + 3).join();
  index.forEach((v) => first.has(at(v)) || first.set(at(v), v));
  return { positions, index: index.map((v) => first.get(at(v))) };
}

test("default meshes of surfaces have as many triangles as those of the Python package, and no gaps", async () => {
  const shapes = JSON.parse(readFileSync(new URL("silhouettes.json", import.meta.url)));
  for (const [path, { triangles }] of Object.entries(shapes)) {
    if (triangles === undefined) continue;
    const model = await decode(bytesOf(path));
    const mesh = await model.toMesh();
    assert.equal(mesh.index.length / 3, triangles, path);
    assert.ok(mesh.index.every((v) => v < mesh.positions.length / 3), path);
    if (model.closed && model.oriented) assert.ok(solid(welded(mesh)).closed, path);
  }
});

test("a tolerance says how many triangles a surface gets", async () => {
  const model = await decode(bytesOf(vector("surface-smooth")));
  const meshes = await Promise.all([0.1, 0.5, 2, 10].map((tolerance) => model.toMesh({ tolerance })));
  const [finest, byDefault, coarse, coarsest] = meshes.map((mesh) => mesh.index.length / 3);
  assert.ok(finest > byDefault && byDefault > coarse && coarse > coarsest, String([finest, byDefault, coarse, coarsest]));
  assert.equal(byDefault, (await model.toMesh()).index.length / 3);
  for (const mesh of meshes) assert.ok(solid(welded(mesh)).closed);
  // Whatever it is, triangles stay within a hundredth of the diagonal.
  assert.equal((await model.toMesh({ tolerance: 100 })).index.length / 3, (await model.toMesh({ tolerance: 99 })).index.length / 3);
  for (const tolerance of [0, -1, 101, NaN, "2", 2n, null]) await assert.rejects(model.toMesh({ tolerance }), OptionError);
});

test("a default mesh is as much outside as inside", async () => {
  const model = await decode(bytesOf(vector("surface-smooth")));
  const [own, exact] = [await model.toMesh(), await model.toMesh({ level: 6 })].map((mesh) => solid(mesh).volume);
  assert.ok(Math.abs(own / exact - 1) < 2e-4, `${own} of ${exact}`);
});

test("an empty solid has no mesh", async () => {
  const model = await decode(bytesOf("spec/vectors/accepted/rans.cndhf"));
  await assert.rejects(model.toMesh(), SurfaceError);
});

test("the finest meshes are refused where they are too large", async () => {
  const model = await decode(bytesOf(vector("surface-genus")));
  assert.equal((await model.toMesh({ level: 6 })).index.length, 3 * 100 * 4 ** 6);
});

test("points far away, and points that are no numbers, are outside", async () => {
  for (const path of [vector("surface-smooth"), "examples/bracket.cndhf"]) {
    const model = await decode(bytesOf(path));
    const points = [NaN, 0, 0, 0, NaN, 0, 0, 0, NaN, Infinity, 0, 0, 1e300, -1e300, 1e300, -1e9, 0, 0];
    assert.deepEqual([...model.contains(points)], [0, 0, 0, 0, 0, 0], path);
  }
});
