// Time to a mesh that can be drawn, against Draco's decoder with its wasm start-up, on a Draco file of equal bytes of the
// same shape: node bench/draco.mjs FILE.cndhf [RUNS [CHROMIUM]]
//
// Every run is a fresh process or a fresh page, in turn: it gets the decoder, decodes, and makes positions, normals and
// index; of surfaces level 1, which is nearer to the shape than the peer's mesh, and the default mesh. "Decoded" is how
// long double height fields take until a graphics card can draw them from their weights. Pages are Chromium's: with
// decoders that lie on this machine, and over a line of 10 Mbit/s, as on a first visit. There Draco is what DRACOLoader
// of three.js takes for glTF, the smaller one of two.
// The peer is the shape's mesh, simplified (meshoptimizer) and coded (Draco, 11 bits) to the size of FILE.
import { spawnSync } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { MeshoptSimplifier } from "meshoptimizer";
import { chromium } from "playwright-core";
import { decode } from "../dist/index.js";
import { serve } from "../test/serve.mjs";

const LINE = { latency: 40, downloadThroughput: 10e6 / 8, uploadThroughput: 10e6 / 8 }; // milliseconds there and back, bytes per second

const [, , file, runs = "15", executablePath = "/usr/bin/chromium"] = process.argv;
const folder = mkdtempSync(join(tmpdir(), "cndhf-"));
try {
  const own = readFileSync(file);
  const model = await decode(own);
  const peer = join(folder, "peer.drc");
  writeFileSync(peer, await peerOf(await model.toMesh(), own.length));
  const ways = { draco: [peer], ours: [file, {}] };
  if (model.representation === "surface") ways["ours, level 1"] = [file, { level: 1 }];
  const script = fileURLToPath(new URL("once.mjs", import.meta.url));
  await compare("Node.js", ways, (path, options) => {
    // Once in a hundred runs Node.js 20 does not end after its last line, hence the limit of time.
    const run = [script, path, JSON.stringify(options ?? null)];
    const { stdout, stderr } = spawnSync(process.execPath, run, { encoding: "utf8", timeout: 10_000 });
    if (!stdout) throw new Error(stderr);
    return JSON.parse(stdout);
  });
  if (existsSync(executablePath)) {
    const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
    for (const [where, line] of [["Chromium", null], ["Chromium, 10 Mbit/s", LINE]]) {
      const { server, address } = await serve({ gzip: line !== null });
      await compare(where, ways, async (path, options) => {
        const context = await browser.newContext();
        const page = await context.newPage();
        await page.goto(new URL("bench/empty.html", address).href);
        if (line) {
          const session = await context.newCDPSession(page);
          await session.send("Network.enable");
          await session.send("Network.emulateNetworkConditions", { offline: false, ...line });
        }
        const found = await page.evaluate(inPage, [options ?? null, [...readFileSync(path)]]);
        await context.close();
        return found;
      });
      server.close();
    }
    await browser.close();
  }
} finally {
  rmSync(folder, { recursive: true });
}

async function compare(where, ways, run) {
  const found = Object.fromEntries(Object.keys(ways).map((name) => [name, []]));
  for (let k = 0; k < Number(runs); k++) {
    for (const name of Object.keys(ways)) found[name].push(await run(...ways[name]));
  }
  const median = (name, key) => found[name].map((x) => x[key]).sort((a, b) => a - b)[found[name].length >> 1];
  for (const name of Object.keys(ways)) {
    const [time, decoded] = ["milliseconds", "decoded"].map((key) => median(name, key));
    const ratio = (x) => `${(x / median("draco", "milliseconds")).toFixed(2)} of Draco's`;
    console.log(
      `${where}, ${name}: ${readFileSync(ways[name][0]).length} bytes, ${found[name][0].triangles} triangles, ${time.toFixed(1)} ms` +
        (name === "draco" ? "" : `, ${ratio(time)}; decoded after ${decoded.toFixed(1)} ms, ${ratio(decoded)}`),
    );
  }
}

/** One run in a page. */
async function inPage([options, bytes]) {
  const data = Uint8Array.from(bytes);
  const { draco, ours } = await import("/web/bench/decoders.mjs");
  const libraries = "/web/node_modules/three/examples/jsm/libs/draco/gltf/";
  const start = performance.now();
  let found;
  if (options) found = await ours(await import("/web/dist/index.js"), data, options);
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

async function peerOf({ positions, index }, size) {
  const encoderModule = await createRequire(import.meta.url)("draco3d").createEncoderModule({});
  await MeshoptSimplifier.ready;
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
