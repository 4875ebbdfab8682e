// Bundles src into dist with esbuild: node build.mjs
import { build } from "esbuild";
import { rmSync } from "node:fs";

rmSync("dist", { recursive: true, force: true });
const options = {
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: process.env.MINIFY !== "0",
  sourcemap: true,
  splitting: true,
  outdir: "dist",
  chunkNames: "chunks/[name]-[hash]",
  external: ["three", "three/*"],
  logLevel: "warning",
};
await build({ ...options, entryPoints: { index: "src/index.ts" } });
