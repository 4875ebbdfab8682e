// A server of web/ for the tests in a browser.
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { extname, join, normalize, sep } from "node:path";
import { fileURLToPath } from "node:url";

const ROOT = fileURLToPath(new URL("../..", import.meta.url));
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".css": "text/css" };

/** Serve the repository on a free port of this machine; the server, and the address of web/. */
export async function serve() {
  const server = createServer(async (request, response) => {
    const path = join(ROOT, normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)));
    if (!path.startsWith(ROOT + (ROOT.endsWith(sep) ? "" : sep))) return response.writeHead(403).end();
    try {
      const data = await readFile(path);
      response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" }).end(data);
    } catch {
      response.writeHead(404).end();
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return { server, address: `http://127.0.0.1:${server.address().port}/web/` };
}
