// usage: node serve.mjs scene.glb picture.png
// Serves viewer.html, three.js and the scene on a free port of localhost, and writes the picture that the viewer sends.
// Prints the port, then what the viewer reports.
import { createServer } from "node:http";
import { readFileSync, writeFileSync } from "node:fs";
import { dirname, extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const types = { ".html": "text/html", ".js": "text/javascript", ".glb": "model/gltf-binary" };
const server = createServer((request, response) => {
  const url = new URL(request.url, "http://localhost");
  const path = normalize(url.pathname);
  if (path === "/report") {
    console.log(url.searchParams.get("text"));
    response.writeHead(204).end();
    return;
  }
  if (path === "/picture" && request.method === "POST") {
    const parts = [];
    request.on("data", (part) => parts.push(part));
    request.on("end", () => {
      writeFileSync(process.argv[3], Buffer.concat(parts));
      response.writeHead(204).end();
    });
    return;
  }
  try {
    const body = readFileSync(path === "/scene.glb" ? process.argv[2] : join(here, path));
    response.writeHead(200, { "Content-Type": types[extname(path)] ?? "application/octet-stream" }).end(body);
  } catch {
    response.writeHead(404).end();
  }
});
server.listen(0, "127.0.0.1", () => console.log(server.address().port));
