// What is timed, in Node.js and in a page: bytes to positions, normals and index in typed arrays.

/** With the decoder of dist/; `options` of toMesh. `decoded`: when double height fields can be drawn from their weights. */
export async function ours({ decode }, data, options) {
  const model = await decode(data);
  const decoded = performance.now();
  const mesh = await model.toMesh(options);
  return { triangles: mesh.index.length / 3, decoded };
}

/** With a module of draco3d. The file has no normals, which take a third of its size: they are made of the triangles. */
export function draco(module, data) {
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

/** Sums of the triangles' normals by area, as three.js makes them, without its objects. */
function vertexNormals(p, index) {
  const out = new Float32Array(p.length);
  for (let f = 0; f < index.length; f += 3) {
    const a = 3 * index[f];
    const b = 3 * index[f + 1];
    const c = 3 * index[f + 2];
    const ux = p[b] - p[a];
    const uy = p[b + 1] - p[a + 1];
    const uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a];
    const vy = p[c + 1] - p[a + 1];
    const vz = p[c + 2] - p[a + 2];
    const x = uy * vz - uz * vy;
    const y = uz * vx - ux * vz;
    const z = ux * vy - uy * vx;
    for (let k = f; k < f + 3; k++) {
      const v = 3 * index[k];
      out[v] += x;
      out[v + 1] += y;
      out[v + 2] += z;
    }
  }
  for (let v = 0; v < out.length; v += 3) {
    const length = Math.sqrt(out[v] ** 2 + out[v + 1] ** 2 + out[v + 2] ** 2) || 1;
    out[v] /= length;
    out[v + 1] /= length;
    out[v + 2] /= length;
  }
  return out;
}
