// A server of web/ for the tests in a browser.
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { gzipSync } from "node:zlib";
import { extname, join, normalize, sep } from "node:path";
import { fileURLToPath } from "node:url";

const ROOT = fileURLToPath(new URL("../..", import.meta.url));
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css" };

/** Serve the repository on a free port of this machine, gzipped where that is wanted; the server, and the address of web/. */
export async function serve({ gzip = false } = {}) {
  const zipped = new Map();
  const server = createServer(async (request, response) => {
    const path = join(ROOT, normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)));
    if (!path.startsWith(ROOT + (ROOT.endsWith(sep) ? "" : sep))) return response.writeHead(403).end();
    try {
      const data = zipped.get(path) ?? (gzip ? gzipSync(await readFile(path), { level: 9 }) : await readFile(path));
      if (gzip) zipped.set(path, data);
      const headers = { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" };
      response.writeHead(200, gzip ? { ...headers, "Content-Encoding": "gzip" } : headers).end(data);
    } catch {
      response.writeHead(404).end();
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { server, address: `http://127.0.0.1:${server.address().port}/web/` };
}
