// Bundles src into dist: node build.mjs; with --package, the viewer goes into the Python package, too. esbuild bundles; terser makes the result smaller by a twelfth.
import { build } from "esbuild";
import { minify } from "terser";
import { readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";

/** The other entry points take the decoder from dist/index.js, so that a page has it once. */
const decoderApart = {
  name: "decoder-apart",
  setup(bundle) {
    bundle.onResolve({ filter: /^\.\.?\/index\.js$/ }, ({ path, importer }) =>
      /src\/(three\/\w+|workers?|glb)\.ts$/.test(importer) && !importer.endsWith("three/index.ts")
        ? { path: "./index.js", external: true }
        : undefined,
    );
  },
};

// Names of properties that are used within dist/index.js only. They become shorter there, for 200 bytes.
const OWN = [
  "adaptive", "bias", "bit", "bodies", "count", "divided", "finish", "frequencies", "header", "inputs", "items", "kind",
  "layers", "limit", "lookup", "matrix", "mesh", "network", "normalised", "nVertices", "ofCorner", "ofNew", "ofSector", "outputs", "raw",
  "refined", "sharpness", "starts", "take", "topology", "valences", "winding", "zero",
];

/** A module made smaller; with the source map of what it was made from, its own goes to `path`.map. */
async function smaller(code, map, path) {
  const out = await minify(code, {
    module: true,
    ecma: 2020,
    compress: { passes: 5, pure_getters: true, hoist_funs: true, unsafe_arrows: !!path }, // three.js has functions that are constructors
    mangle: path === "dist/index.js" ? { properties: { builtins: true, regex: new RegExp(`^(${OWN.join("|")})$`) } } : {},
    ...(path && { sourceMap: { ...map, url: `${path.split("/").pop()}.map` } }),
  });
  if (path) writeFileSync(`${path}.map`, out.map);
  return out.code;
}

const options = {
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  sourcemap: true,
  outdir: "dist",
  external: ["three", "three/*"],
  logLevel: "warning",
};

rmSync("dist", { recursive: true, force: true });
await build({ ...options, entryPoints: { index: "src/index.ts" }, splitting: true, chunkNames: "chunks/[name]-[hash]" });
await build({
  ...options,
  entryPoints: { three: "src/three/index.ts", worker: "src/worker.ts", glb: "src/glb.ts" },
  plugins: [decoderApart],
});

for (const name of readdirSync("dist", { recursive: true }).filter((path) => path.endsWith(".js"))) {
  const path = `dist/${name}`;
  writeFileSync(path, await smaller(readFileSync(path, "utf8"), { content: readFileSync(`${path}.map`, "utf8") }, path));
}

// The viewer is one page that needs nothing else: style and script are put into it, with the licence of three.js, which asks for that.
const [{ text: script }] = (
  await build({
    ...options,
    entryPoints: ["viewer/main.ts"],
    external: [],
    sourcemap: false,
    write: false,
    splitting: false,
    legalComments: "inline",
  })
).outputFiles;
const small = await smaller(script);
const style = (await build({ entryPoints: ["viewer/style.css"], minify: true, write: false })).outputFiles[0].text;
const page = readFileSync("viewer/index.html", "utf8")
  .replace("licence of three.js", () => readFileSync("node_modules/three/LICENSE", "utf8").trim())
  .replace("/*style*/", () => style.trim())
  .replace("/*script*/", () => small.trim().replaceAll("</script", "<\\/script"));
writeFileSync("dist/viewer.html", page);
if (process.argv.includes("--package")) writeFileSync("../cndhf_codec/viewer/viewer.html", page);
