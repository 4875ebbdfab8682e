// Time to a mesh that can be drawn, against Draco's decoder with its wasm start-up, on a Draco file of equal bytes of the
// same shape, in Node.js and in Chromium: node bench/draco.mjs FILE.cndhf [RUNS [CHROMIUM]]
//
// Every run is a fresh process or a fresh page, in turn: it gets the decoder, from the disk or from a server of this
// machine, decodes, and makes positions, normals and index. In pages Draco is what DRACOLoader of three.js takes.
// "Decoded" is how long double height fields take until a graphics card can draw them from their weights.
// The peer is the shape's mesh, simplified (meshoptimizer) and coded (Draco, 11 bits) to the size of FILE. It has far fewer
// triangles, so the times per triangle are printed, too.
import { execFileSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";
import { serve } from "../test/serve.mjs";
import { draco, ours } from "./decoders.mjs";

const [, script, file, option = "15", executablePath = "/usr/bin/chromium"] = process.argv;
if (option === "ours" || option === "draco") console.log(JSON.stringify(await once(option, new Uint8Array(readFileSync(file)))));
else {
  const folder = mkdtempSync(join(tmpdir(), "cndhf-"));
  try {
    const own = readFileSync(file);
    const peer = join(folder, "peer.drc");
    writeFileSync(peer, await peerOf(file, own.length));
    const files = { ours: file, draco: peer };
    const sizes = { ours: own.length, draco: readFileSync(peer).length };
    await compare("Node.js", sizes, (name) =>
      JSON.parse(execFileSync(process.execPath, [script, files[name], name], { encoding: "utf8" })),
    );
    if (existsSync(executablePath)) {
      const { server, address } = await serve();
      const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
      await compare("Chromium", sizes, async (name) => {
        const context = await browser.newContext();
        const page = await context.newPage();
        await page.goto(new URL("bench/empty.html", address).href);
        const found = await page.evaluate(inPage, [name, [...readFileSync(files[name])]]);
        await context.close();
        return found;
      });
      await browser.close();
      server.close();
    }
  } finally {
    rmSync(folder, { recursive: true });
  }
}

async function compare(where, sizes, run) {
  const found = { ours: [], draco: [] };
  for (let k = 0; k < Number(option); k++) {
    for (const name of ["ours", "draco"]) found[name].push(await run(name));
  }
  const median = (name, key) => found[name].map((x) => x[key]).sort((a, b) => a - b)[found[name].length >> 1];
  const times = { ours: median("ours", "milliseconds"), draco: median("draco", "milliseconds") };
  const decoded = median("ours", "decoded");
  for (const name of ["ours", "draco"]) {
    const n = found[name][0].triangles;
    const after = name === "ours" ? `, decoded after ${decoded.toFixed(1)} ms` : "";
    console.log(
      `${where}, ${name}: ${sizes[name]} bytes, ${n} triangles, ${times[name].toFixed(1)} ms, ` +
        `${((1000 * times[name]) / n).toFixed(1)} us per triangle${after}`,
    );
  }
  const perTriangle = (times.ours / found.ours[0].triangles) / (times.draco / found.draco[0].triangles);
  console.log(
    `${where}, ratios of medians over Draco's: ${(times.ours / times.draco).toFixed(2)}, ` +
      `per triangle ${perTriangle.toFixed(2)}, decoded ${(decoded / times.draco).toFixed(2)}`,
  );
}

/** One run in this process. */
async function once(name, data) {
  const start = performance.now();
  const { triangles, decoded } = await (name === "ours"
    ? ours(await import("../dist/index.js"), data)
    : draco(await createRequire(import.meta.url)("draco3d").createDecoderModule({}), data));
  const end = performance.now();
  return { milliseconds: end - start, decoded: (decoded ?? end) - start, triangles };
}

/** One run in a page. */
async function inPage([name, bytes]) {
  const data = Uint8Array.from(bytes);
  const { draco, ours } = await import("/web/bench/decoders.mjs");
  const libraries = "/web/node_modules/three/examples/jsm/libs/draco/";
  const start = performance.now();
  let found;
  if (name === "ours") found = await ours(await import("/web/dist/index.js"), data);
  else {
    const wasm = fetch(`${libraries}draco_decoder.wasm`).then((response) => response.arrayBuffer());
    await new Promise((resolve, reject) => {
      const tag = Object.assign(document.createElement("script"), { src: `${libraries}draco_wasm_wrapper.js` });
      tag.onload = resolve;
      tag.onerror = reject;
      document.head.append(tag);
    });
    found = draco(await DracoDecoderModule({ wasmBinary: await wasm }), data);
  }
  const end = performance.now();
  return { milliseconds: end - start, decoded: (found.decoded ?? end) - start, triangles: found.triangles };
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
