// Bundles src into dist with esbuild: node build.mjs
import { build } from "esbuild";
import { readFileSync, rmSync, writeFileSync } from "node:fs";

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

// The viewer is one page that needs nothing else: style and script are put into it.
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
const style = (await build({ entryPoints: ["viewer/style.css"], minify: true, write: false })).outputFiles[0].text;
const page = readFileSync("viewer/index.html", "utf8")
  .replace("/*style*/", () => style.trim())
  .replace("/*script*/", () => script.trim().replaceAll("</script", "<\\/script"));
writeFileSync("dist/viewer.html", page);
