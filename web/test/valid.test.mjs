// Files that must load, with the values that the reference decoder gives for them.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";
import { decode, SheetError } from "../dist/index.js";
import { bytesOf, expected, rowsOf, vector } from "./files.mjs";

const TOLERANCE = 2e-6; // normalised units

function close(found, wanted, tolerance, what) {
  assert.equal(found.length, wanted.length, what);
  for (let i = 0; i < found.length; i++) {
    assert.ok(Math.abs(found[i] - wanted[i]) <= tolerance, `${what}: ${found[i]} instead of ${wanted[i]} at ${i}`);
  }
}

test("what is public keeps its names in the bundle", async () => {
  const dhf = await decode(bytesOf(vector("dhf-rans")));
  assert.deepEqual(Object.keys(dhf.info.sections), ["layout", "metadata", "records", "weights"]);
  assert.deepEqual(Object.keys(dhf.info), [
    "representation", "bytes", "sections", "centre", "scale", "encoder", "source", "meanError", "p99Error", "maxError",
  ]);
  const [{ record, tensors, rotation }] = dhf.fields;
  assert.deepEqual(Object.keys(record), [
    "fold", "quaternion", "box", "width", "hiddenLayers", "omegaFirst", "omegaHidden", "steps", "sizes",
  ]);
  assert.equal(record.sizes.length, tensors.length);
  assert.equal(rotation.length, 9);
  const { control, info } = await decode(bytesOf(vector("surface-smooth")));
  assert.deepEqual(Object.keys(info.sections), ["layout", "surface", "metadata"]);
  assert.deepEqual(Object.keys(control), ["quaternion", "step", "positions", "faces", "edges", "sharp"]);
  assert.deepEqual(Object.keys(control.edges), ["ends", "ofHalf", "opposite", "first", "after"]);
});

for (const [name, wanted] of Object.entries(expected)) {
  test(name, async (t) => {
    const bytes = bytesOf(vector(name));
    assert.equal(createHash("sha256").update(bytes).digest("hex"), wanted.sha256);
    const model = await decode(bytes);
    await t.test("info", () => {
      const { info } = model;
      assert.equal(info.representation, wanted.heights ? "dhf" : "surface");
      assert.equal(info.bytes, bytes.length);
      assert.equal(Object.values(info.sections).reduce((a, b) => a + b), bytes.length);
      assert.deepEqual(info.centre, wanted.centre);
      assert.equal(info.scale, wanted.scale);
      assert.equal(info.encoder, wanted.encoder);
      assert.equal(info.source, wanted.source);
      assert.deepEqual([info.meanError, info.p99Error, info.maxError], wanted.errors ?? [null, null, null]);
    });
    if (wanted.points) {
      await t.test("contains", () => {
        assert.deepEqual([...model.contains(wanted.points.flat())], wanted.contains);
      });
    }
    if (model.representation === "dhf") {
      await t.test("heights and f", () => {
        assert.equal(model.fields.length, wanted.heights.length);
        wanted.heights.forEach((heights, i) => {
          close(model.heights(i, wanted.uv.flat()), heights.flat(), TOLERANCE, `heights ${i}`);
        });
        close(model.implicit(wanted.points.flat()), wanted.f, TOLERANCE * model.scale, "f");
      });
      return;
    }
    await t.test("control mesh", () => {
      const { control } = model;
      assert.deepEqual(control.quaternion, wanted.quaternion);
      assert.equal(control.step, wanted.step);
      assert.deepEqual([...control.positions], wanted.positions.flat());
      assert.deepEqual([...control.faces], wanted.faces.flat());
      const { ends, ofHalf, opposite } = control.edges;
      const inner = new Set(ofHalf.filter((_, h) => opposite[h] >= 0));
      const sharp = [...control.sharp.keys()].filter((e) => control.sharp[e] && inner.has(e));
      assert.deepEqual(sharp.flatMap((e) => [ends[2 * e], ends[2 * e + 1]]), wanted.sharp.flat());
      assert.equal(model.closed && model.oriented, wanted.solid);
      assert.equal(model.controlVertices().length, control.positions.length);
    });
    if (!wanted.solid) {
      await t.test("a sheet has no inside", () => assert.throws(() => model.contains([0, 0, 0]), SheetError));
    }
    for (const { level, faces, corners } of wanted.levels) {
      await t.test(`level ${level}`, async () => {
        const { positions, normals, index, origin } = await model.toMesh({ level });
        assert.equal(index.length, 3 * faces);
        for (const [face, corner, ...values] of corners) {
          const v = 3 * index[3 * face + corner];
          const point = [0, 1, 2].map((k) => positions[v + k] + origin[k]);
          close(point, values.slice(0, 3), TOLERANCE * model.scale, `face ${face}, corner ${corner}`);
          close(normals.subarray(v, v + 3), values.slice(3), 1e-6, `normal at face ${face}, corner ${corner}`);
        }
      });
    }
  });
}

test("spec/vectors/accepted", async (t) => {
  for (const [name] of rowsOf("spec/vectors/accepted")) {
    await t.test(name, async () => assert.equal((await decode(bytesOf(`spec/vectors/accepted/${name}`))).fields.length, 1));
  }
});

test("an ArrayBuffer, and a view into a larger one", async () => {
  const bytes = bytesOf("examples/bracket.cndhf");
  const larger = new Uint8Array(bytes.length + 7);
  larger.set(bytes, 5);
  const [a, b] = await Promise.all([
    decode(Uint8Array.from(bytes).buffer),
    decode(larger.subarray(5, 5 + bytes.length)),
  ]);
  assert.deepEqual(a.info, b.info);
});
