// usage: node click_tour.mjs TOUR_FOLDER|TOUR.html PATH_OF_NODES [SCREENSHOT_FOLDER]
// Opens a tour of panoramas in a headless Chromium (software WebGL, no display; nothing leaves this machine) and clicks
// through the nodes in the order given ("0,3,1"), each with the mouse on the link that the picture shows: turns until it
// is in sight, clicks, and waits until the panorama is there. Talks to the browser by its DevTools protocol over pipes.
// Prints "visited <name>" for each node; exit code 0 if all were reached.
import { spawn } from "node:child_process";
import { mkdirSync, mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { extname, join, normalize, resolve } from "node:path";

const [tour, order, screenshots] = process.argv.slice(2);
const nodes = order.split(",");
const folder = statSync(tour).isDirectory();
const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".jpg": "image/jpeg" };
const server = createServer((request, response) => {
  const path = normalize(new URL(request.url, "http://localhost").pathname);
  try {
    const body = readFileSync(join(tour, path === "/" ? "index.html" : path));
    response.writeHead(200, { "Content-Type": types[extname(path === "/" ? ".html" : path)] ?? "text/html" }).end(body);
  } catch {
    response.writeHead(404).end();
  }
});
if (folder) await new Promise((done) => server.listen(0, "127.0.0.1", done));
// One file must open without any server.
const address = folder ? `http://127.0.0.1:${server.address().port}/` : `file://${resolve(tour)}`;

const profile = mkdtempSync(join(tmpdir(), "iris-tour-"));
const chromium = spawn(process.env.CHROMIUM ?? "chromium", [
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync", `--user-data-dir=${profile}`, "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader", "--window-size=960,640", "--remote-debugging-pipe", "about:blank",
], { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
const finish = (code, text) => {
  console.log(text);
  chromium.kill("SIGKILL");
  server.close();
  try {
    rmSync(profile, { recursive: true, force: true });
  } catch {
    // The browser may still be writing; it is a temporary folder.
  }
  process.exit(code);
};
chromium.on("error", (error) => finish(3, `no Chromium: ${error.message}`));

let next = 0;
let buffered = "";
const waiting = new Map();
chromium.stdio[4].on("data", (data) => {
  buffered += data;
  for (let end; (end = buffered.indexOf("\0")) >= 0; buffered = buffered.slice(end + 1)) {
    const message = JSON.parse(buffered.slice(0, end));
    if (!waiting.has(message.id)) continue;
    waiting.get(message.id)(message);
    waiting.delete(message.id);
  }
});
let sessionId;
const call = (method, params = {}) => new Promise((done, failed) => {
  const id = ++next;
  waiting.set(id, (message) => (message.error ? failed(new Error(message.error.message)) : done(message.result)));
  chromium.stdio[3].write(JSON.stringify({ id, method, params, sessionId }) + "\0");
});
const evaluate = async (expression) => {
  const { result, exceptionDetails } = await call("Runtime.evaluate", { expression, returnByValue: true });
  if (exceptionDetails) throw new Error(exceptionDetails.exception?.description ?? exceptionDetails.text);
  return result.value;
};
const until = async (expression, what) => {
  for (let i = 0; i < 600; ++i) {
    if (await evaluate(expression)) return;
    await new Promise((done) => setTimeout(done, 100));
  }
  throw new Error(`waited in vain for ${what}`);
};
const shoot = async (name) => {
  if (!screenshots) return;
  mkdirSync(screenshots, { recursive: true });
  const { data } = await call("Page.captureScreenshot", { format: "png" });
  writeFileSync(join(screenshots, name), Buffer.from(data, "base64"));
};
setTimeout(() => finish(1, "took longer than 5 minutes"), 300_000);

try {
  const { targetInfos } = await call("Target.getTargets");
  const page = targetInfos.find((target) => target.type === "page");
  sessionId = (await call("Target.attachToTarget", { targetId: page.targetId, flatten: true })).sessionId;
  await call("Page.enable");
  await call("Page.navigate", { url: address });
  await until("document.readyState === 'complete' && (!!window.viewer || document.getElementById('message')?.textContent)",
    "the page");
  const message = await evaluate("document.getElementById('message').textContent");
  if (message) throw new Error(message);
  const at = (node) => `viewer.isLoaded() && viewer.getScene() === "node${node}"`;
  await until(at(nodes[0]), `node ${nodes[0]}`);
  console.log(`visited node${nodes[0]}`);
  await shoot(`0-node${nodes[0]}.png`);
  for (let i = 1; i < nodes.length; ++i) {
    const link = `viewer.getConfig().hotSpots.find((spot) => spot.sceneId === "node${nodes[i]}")`;
    if (!(await evaluate(`!!${link}`))) throw new Error(`node${nodes[i - 1]} has no link to node${nodes[i]}`);
    await evaluate(`viewer.lookAt(${link}.pitch, ${link}.yaw, 90, false)`);
    await new Promise((done) => setTimeout(done, 600));
    // The picture of the link: where the mouse must go.
    const { x, y } = await evaluate(`(() => {
      const box = ${link}.div.getBoundingClientRect();
      return { x: box.x + box.width / 2, y: box.y + box.height / 2 };
    })()`);
    if (!(x > 0 && x < 960 && y > 0 && y < 640)) throw new Error(`the link to node${nodes[i]} is not in sight: ${x}, ${y}`);
    for (const type of ["mouseMoved", "mousePressed", "mouseReleased"]) {
      await call("Input.dispatchMouseEvent", { type, x, y, button: type === "mouseMoved" ? "none" : "left", clickCount: 1 });
    }
    await until(at(nodes[i]), `node ${nodes[i]}`);
    await new Promise((done) => setTimeout(done, 900));  // fading
    console.log(`visited node${nodes[i]}`);
    await shoot(`${i}-node${nodes[i]}.png`);
  }
  finish(0, "done");
} catch (error) {
  await shoot("failed.png").catch(() => {});
  finish(1, `failed: ${error.message}`);
}
