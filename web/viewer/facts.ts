/** What a file is like, as rows of a table. */
import type { Mesh, Model } from "../src/index.js";

const number = (x: number): string => (Number.isInteger(x) ? x.toLocaleString("en") : x.toPrecision(3));

export function factsOf(model: Model, mesh: Mesh | null): [string, string][] {
  const { info } = model;
  const rows: [string, string][] = [
    ["Representation", info.representation === "dhf" ? "double height fields" : "subdivision surface"],
    ["Bytes", number(info.bytes)],
    ...Object.entries(info.sections).map(([name, size]): [string, string] => [`– ${name}`, number(size)]),
  ];
  if (model.representation === "dhf") {
    rows.push(["Fields", number(model.fields.length)]);
    const weights = model.fields.reduce((sum, f) => sum + f.tensors.reduce((n, t) => n + t.length, 0), 0);
    rows.push(["Weights", number(weights)]);
  } else {
    rows.push(["Control vertices", number(model.control.positions.length / 3)]);
    rows.push(["Control faces", number(model.control.faces.length / 3)]);
    rows.push(["Closed", model.closed ? "yes" : "no: a sheet"]);
  }
  if (mesh) rows.push(["Triangles drawn", number(mesh.index.length / 3)]);
  const errors: [string, number | null][] = [
    ["Mean error", info.meanError], ["99th percentile", info.p99Error], ["Greatest error", info.maxError],
  ];
  for (const [name, value] of errors) if (value !== null) rows.push([name, number(value)]);
  if (info.encoder) rows.push(["Encoder", info.encoder]);
  if (info.source) rows.push(["Source", info.source]);
  return rows;
}
