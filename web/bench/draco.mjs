// Time to a mesh that can be drawn, against draco3d with its wasm start-up, on a Draco file of equal bytes of the same
// shape: node bench/draco.mjs FILE.cndhf [RUNS]
//
// Every run is a fresh process, as a page is: it imports the decoder, decodes, and makes positions, normals and index.
// "Decoded" is how long double height fields take until a graphics card can draw them from their weights.
// The peer is the shape's mesh, simplified (meshoptimizer) and coded (Draco, 11 bits) to the size of FILE.
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";

const [, script, file, option] = process.argv;
if (option === "ours" || option === "draco") {
  const data = new Uint8Array(readFileSync(file));
  const start = performance.now();
  const { triangles, decoded } = await (option === "ours" ? ours : draco)(data);
  const end = performance.now();
  console.log(JSON.stringify({ milliseconds: end - start, decoded: (decoded ?? end) - start, triangles }));
} else {
  const folder = mkdtempSync(join(tmpdir(), "cndhf-"));
  try {
    const size = readFileSync(file).length;
    const peer = join(folder, "peer.drc");
    writeFileSync(peer, await peerOf(file, size));
    const times = { ours: [], draco: [], decoded: [] };
    const triangles = {};
    for (let run = 0; run < Number(option ?? 15); run++) {
      for (const [name, path] of [["ours", file], ["draco", peer]]) {
        const out = JSON.parse(execFileSync(process.execPath, [script, path, name], { encoding: "utf8" }));
        times[name].push(out.milliseconds);
        if (name === "ours") times.decoded.push(out.decoded);
        triangles[name] = out.triangles;
      }
    }
    const median = (x) => x.sort((a, b) => a - b)[x.length >> 1];
    const [a, b, c] = [median(times.ours), median(times.draco), median(times.decoded)];
    console.log(`cndhf: ${size} bytes, ${triangles.ours} triangles, ${a.toFixed(1)} ms, decoded after ${c.toFixed(1)} ms`);
    console.log(`draco3d: ${readFileSync(peer).length} bytes, ${triangles.draco} triangles, ${b.toFixed(1)} ms`);
    console.log(`ratios of medians over draco3d: ${(a / b).toFixed(2)}, decoded ${(c / b).toFixed(2)}`);
  } finally {
    rmSync(folder, { recursive: true });
  }
}

async function ours(data) {
  const { decode } = await import("../dist/index.js");
  const model = await decode(data);
  const decoded = performance.now();
  const mesh = await model.toMesh();
  return { triangles: mesh.index.length / 3, decoded };
}

async function draco(data) {
  const require = createRequire(import.meta.url);
  const module = await require("draco3d").createDecoderModule({});
  const decoder = new module.Decoder();
  const mesh = new module.Mesh();
  const status = decoder.DecodeArrayToMesh(data, data.length, mesh);
  if (!status.ok()) throw new Error(status.error_msg());
  const nFaces = mesh.num_faces();
  const nPoints = mesh.num_points();
  const attribute = decoder.GetAttributeByUniqueId(mesh, 0);
  const read = (bytes, fill) => {
    const at = module._malloc(bytes);
    fill(at);
    const out = module.HEAPU8.slice(at, at + bytes).buffer;
    module._free(at);
    return out;
  };
  const index = new Uint32Array(read(12 * nFaces, (at) => decoder.GetTrianglesUInt32Array(mesh, 12 * nFaces, at)));
  const positions = new Float32Array(
    read(12 * nPoints, (at) =>
      decoder.GetAttributeDataArrayForAllPoints(mesh, attribute, module.DT_FLOAT32, 12 * nPoints, at),
    ),
  );
  vertexNormals(positions, index);
  return { triangles: nFaces };
}

// Sums of the triangles' normals by area, as three.js makes them.
function vertexNormals(p, index) {
  const out = new Float32Array(p.length);
  for (let f = 0; f < index.length; f += 3) {
    const [a, b, c] = [3 * index[f], 3 * index[f + 1], 3 * index[f + 2]];
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    for (const v of [a, b, c]) {
      out[v] += uy * vz - uz * vy;
      out[v + 1] += uz * vx - ux * vz;
      out[v + 2] += ux * vy - uy * vx;
    }
  }
  for (let v = 0; v < out.length; v += 3) {
    const length = Math.hypot(out[v], out[v + 1], out[v + 2]) || 1;
    for (let k = 0; k < 3; k++) out[v + k] /= length;
  }
  return out;
}

async function peerOf(path, size) {
  const { decode } = await import("../dist/index.js");
  const { MeshoptSimplifier } = await import("meshoptimizer");
  const encoderModule = await createRequire(import.meta.url)("draco3d").createEncoderModule({});
  await MeshoptSimplifier.ready;
  const model = await decode(new Uint8Array(readFileSync(path)));
  const { positions, index } = await model.toMesh();
  let best = null;
  for (let low = 4, high = index.length / 3; low < high; ) {
    const faces = (low + high + 1) >> 1;
    const [simple] = MeshoptSimplifier.simplify(index, positions, 3, 3 * faces, 1);
    const coded = encode(encoderModule, positions, simple);
    if (coded.length <= size) {
      best = coded;
      low = faces;
    } else high = faces - 1;
  }
  return best;
}

function encode(module, positions, index) {
  const numbers = new Map();
  const points = [];
  const faces = Uint32Array.from(index, (v) => {
    if (!numbers.has(v)) {
      numbers.set(v, numbers.size);
      points.push(positions[3 * v], positions[3 * v + 1], positions[3 * v + 2]);
    }
    return numbers.get(v);
  });
  const builder = new module.MeshBuilder();
  const mesh = new module.Mesh();
  builder.AddFacesToMesh(mesh, faces.length / 3, faces);
  builder.AddFloatAttributeToMesh(mesh, module.POSITION, numbers.size, 3, Float32Array.from(points));
  const encoder = new module.Encoder();
  encoder.SetEncodingMethod(module.MESH_EDGEBREAKER_ENCODING);
  encoder.SetSpeedOptions(0, 0);
  encoder.SetAttributeQuantization(module.POSITION, 11);
  const out = new module.DracoInt8Array();
  const length = encoder.EncodeMeshToDracoBuffer(mesh, out);
  const bytes = Uint8Array.from({ length }, (_, i) => out.GetValue(i));
  for (const x of [out, encoder, builder, mesh]) module.destroy(x);
  return bytes;
}
