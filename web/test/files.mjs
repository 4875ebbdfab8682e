// Files of the repository that the tests read.
import { readFileSync } from "node:fs";

export const ROOT = new URL("../../", import.meta.url);

/** A file's bytes, by its path in the repository. */
export const bytesOf = (path) => new Uint8Array(readFileSync(new URL(path, ROOT)));

/** Path in the repository of a file of spec/vectors. */
export const vector = (name) => `spec/vectors/${name}.cndhf`;

/** What is in the files of spec/vectors, by name. */
export const expected = JSON.parse(readFileSync(new URL("spec/vectors/expected.json", ROOT), "utf8"));

/** Rows of a table of files in the folder: name and what follows. */
export const rowsOf = (folder) =>
  readFileSync(new URL(`${folder}/index.tsv`, ROOT), "utf8")
    .trimEnd()
    .split("\n")
    .map((line) => line.split("\t"));
