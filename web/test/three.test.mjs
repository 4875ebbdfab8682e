// What belongs to three.js, without a page: geometries, the loader, glTF.
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { Box3, LoadingManager, MeshStandardMaterial, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { toGlb } from "../dist/glb.js";
import { ChecksumError, decode } from "../dist/index.js";
import { CNDHFLoader, CndhfShapePlugin, DhfRayMarch } from "../dist/three.js";
import { bytesOf, ROOT } from "./files.mjs";

globalThis.self ??= globalThis; // GLTFLoader asks it for URL
globalThis.ProgressEvent ??= class extends Event {}; // and FileLoader for this

const DHF = bytesOf("examples/bracket.cndhf");
const SURFACE = bytesOf("spec/vectors/surface-creases.cndhf");
const FAR = bytesOf("tests/golden/surface.cndhf");

const python = (args) => spawnSync("python3", args, { cwd: fileURLToPath(ROOT), maxBuffer: 1e9 });
const noPython = python(["-c", "import cndhf_codec, click, trimesh"]).status ? "no Python with cndhf_codec" : false;

const dataUrl = (bytes) => `data:application/octet-stream;base64,${Buffer.from(bytes).toString("base64")}`;

async function loadGlb(bytes) {
  const loader = new GLTFLoader().register((parser) => new CndhfShapePlugin(parser, new CNDHFLoader()));
  const { scene } = await loader.parseAsync(Uint8Array.from(bytes).buffer, "");
  return scene.children[0];
}

test("a geometry has the mesh of the model", async () => {
  const geometry = await new CNDHFLoader().setMeshOptions({ resolution: 24 }).parseAsync(DHF);
  const mesh = await (await decode(DHF)).toMesh({ resolution: 24 });
  assert.deepEqual(geometry.attributes.position.array, mesh.positions);
  assert.deepEqual(geometry.attributes.normal.array, mesh.normals);
  assert.deepEqual(geometry.index.array, mesh.index);
  assert.deepEqual(geometry.userData.origin, [0, 0, 0]);
});

test("parse calls back, with a geometry or with an error", async () => {
  const loader = new CNDHFLoader();
  const geometry = await new Promise((resolve, reject) => loader.parse(Uint8Array.from(SURFACE).buffer, resolve, reject));
  assert.deepEqual(geometry.index.array, (await (await decode(SURFACE)).toMesh()).index);
  const bad = SURFACE.slice();
  bad[bad.length - 20] ^= 1;
  await assert.rejects(new Promise((resolve, reject) => loader.parse(bad, resolve, reject)), ChecksumError);
});

test("load goes through the manager", async () => {
  const manager = new LoadingManager();
  const told = [];
  manager.onLoad = () => told.push("loaded");
  manager.onError = () => told.push("error");
  const loader = new CNDHFLoader(manager).setMeshOptions({ level: 1 });
  const geometry = await loader.loadAsync(dataUrl(SURFACE));
  assert.equal(geometry.index.count, 3 * 90 * 4);
  await assert.rejects(loader.loadAsync(dataUrl(SURFACE.subarray(0, 90))), { name: "ChecksumError" });
  assert.ok(told.includes("loaded") && told.includes("error"), String(told));
});

test("glTF: embedded, with and without a fallback", async () => {
  const model = await decode(SURFACE);
  const coarse = await model.toMesh({ level: 0 });
  const fine = await model.toMesh();
  for (const fallback of [true, false]) {
    const object = await loadGlb(toGlb(coarse, { embed: SURFACE, fallback }));
    assert.deepEqual(object.geometry.attributes.position.array, fine.positions);
    assert.deepEqual(object.geometry.index.array, fine.index);
    assert.ok(object.material instanceof MeshStandardMaterial);
  }
  const plain = new GLTFLoader();
  const { scene } = await plain.parseAsync(toGlb(coarse, { embed: SURFACE }).buffer, "");
  assert.equal(scene.children[0].geometry.index.count, coarse.index.length);
  const sizes = [true, false].map((fallback) => toGlb(coarse, { embed: SURFACE, fallback }).length);
  assert.ok(sizes[1] < SURFACE.length + 1200 && sizes[1] < sizes[0], String(sizes));
});

test("glTF: shapes far from the origin keep their place and their precision", async () => {
  const model = await decode(FAR);
  const mesh = await model.toMesh({ level: 1 });
  assert.deepEqual(mesh.origin, model.centre);
  assert.ok(mesh.positions.every((x) => Math.abs(x) <= 2 * model.scale));
  const object = await loadGlb(toGlb(mesh, { embed: FAR }));
  assert.deepEqual(object.position.toArray(), model.centre);
  object.geometry.computeBoundingSphere();
  assert.ok(object.geometry.boundingSphere.radius < 2 * model.scale);
});

test("glTF: what cndhf-decode writes", { skip: noPython }, async () => {
  const coarse = { "spec/vectors/surface-creases.cndhf": ["--level", "1"], "examples/bracket.cndhf": ["--faces", "500"] };
  for (const path of [...Object.keys(coarse), "tests/golden/surface.cndhf"]) {
    const model = await decode(bytesOf(path));
    const fine = await model.toMesh();
    const box = new Box3().setFromArray(fine.positions).translate(new Vector3(...fine.origin));
    for (const options of [["--embed", ...(coarse[path] ?? [])], ["--embed-only"]]) {
      const glb = python(["-c", "from cndhf_codec import cli; cli.decode()", path, "-", "--format", "glb", ...options]).stdout;
      const object = await loadGlb(glb);
      assert.equal(object.geometry.index.count, fine.index.length, `${path} ${options}`);
      object.updateMatrixWorld();
      object.geometry.computeBoundingBox();
      const found = object.geometry.boundingBox.clone().translate(object.position);
      for (const end of ["min", "max"]) assert.ok(found[end].distanceTo(box[end]) < 1e-5 * model.scale, `${path} ${options}`);
    }
  }
});

test("a ray march has the place and size of its solid", async () => {
  const model = await decode(DHF);
  const object = new DhfRayMarch(model, { size: 64 });
  const { positions } = await model.toMesh({ resolution: 32 });
  object.updateMatrixWorld();
  object.geometry.computeBoundingBox();
  const box = object.geometry.boundingBox.clone().applyMatrix4(object.matrixWorld).expandByScalar(1e-3 * model.scale);
  for (let i = 0; i < positions.length; i += 3) {
    assert.ok(box.containsPoint({ x: positions[i], y: positions[i + 1], z: positions[i + 2] }));
  }
  object.dispose();
});
