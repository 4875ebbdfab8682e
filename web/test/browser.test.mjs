// In headless Chromium: silhouettes against those of the Python decoder, the viewer, the examples. Skipped where there is
// no Chromium, unless CNDHF_BROWSER is set: to its path, or to 1 where it lies in a usual place.
import assert from "node:assert/strict";
import { spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { existsSync, mkdirSync, readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";
import { serve } from "./serve.mjs";

const OVERLAP = 0.98;
const silhouettes = JSON.parse(readFileSync(new URL("silhouettes.json", import.meta.url), "utf8"));
const wish = process.env.CNDHF_BROWSER;
const places = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
const executablePath = wish && wish !== "1" ? wish : places.find((path) => existsSync(path));
const skip = executablePath || wish ? false : "no Chromium: set CNDHF_BROWSER to its path";
const SCREENSHOTS = process.env.CNDHF_SCREENSHOTS; // a folder, where somebody wants to look at them
const file = (path) => fileURLToPath(new URL(`../../${path}`, import.meta.url));

let browser, server, address;
before(async () => {
  if (skip) return;
  ({ server, address } = await serve());
  const args = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];
  browser = await chromium.launch({ executablePath, args });
});
after(async () => {
  await browser?.close();
  server?.close();
});

/** A page that was opened, and what it has complained of. */
async function pageAt(path, viewport = { width: 900, height: 600 }) {
  const page = await browser.newPage({ viewport });
  const complaints = [];
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type()) && !/GPU stall|GroupMarkerNotSet/.test(message.text())) {
      complaints.push(message.text());
    }
  });
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(new URL(path, address).href);
  return { page, complaints };
}

async function shoot(page, name) {
  if (!SCREENSHOTS) return;
  mkdirSync(SCREENSHOTS, { recursive: true });
  await page.screenshot({ path: `${SCREENSHOTS}/${name}.png` });
}

const settled = (page) =>
  page.waitForFunction(() => ["ready", "error"].includes(document.body.dataset.state), null, { timeout: 60_000 });

test("silhouettes agree with the Python decoder's", { skip }, async (t) => {
  const { page, complaints } = await pageAt("test/silhouettes.html");
  await page.waitForFunction(() => document.documentElement.dataset.state === "ready");
  for (const [path, { representation, silhouette }] of Object.entries(silhouettes)) {
    const wanted = [...silhouette].flatMap((digit) => [3, 2, 1, 0].map((k) => (parseInt(digit, 16) >> k) & 1));
    for (const march of representation === "dhf" ? [false, true] : [false]) {
      await t.test(`${path}, ${march ? "rays" : "mesh"}`, async () => {
        const found = await page.evaluate(([url, m]) => window.silhouette(url, m), [`/${path}`, march]);
        const both = found.reduce((n, x, i) => n + (x & wanted[i]), 0);
        const either = found.reduce((n, x, i) => n + (x | wanted[i]), 0);
        assert.ok(both / either >= OVERLAP, `${both} of ${either} pixels`);
      });
    }
  }
  await t.test("workers say what is wrong, as the page does", async () => {
    const [name, isOurs] = await page.evaluate(async () => {
      const { SurfaceError } = await import("/web/dist/index.js");
      const { CNDHFLoader } = await import("/web/dist/three.js");
      const bytes = await (await fetch("/spec/vectors/accepted/rans.cndhf")).arrayBuffer();
      return new CNDHFLoader().parseAsync(bytes).catch((e) => [e.name, e instanceof SurfaceError]);
    });
    assert.deepEqual([name, isOurs], ["SurfaceError", true]);
  });
  assert.deepEqual(complaints, []);
});

test("without workers the page makes the meshes", { skip }, async () => {
  const { page, complaints } = await pageAt("test/silhouettes.html");
  await page.route("**/worker.js", (route) => route.abort());
  const triangles = await page.evaluate(async () => {
    const { CNDHFLoader } = await import("/web/dist/three.js");
    const loader = new CNDHFLoader().setMeshOptions({ resolution: 8 });
    const made = await Promise.all([0, 1].map(() => loader.loadAsync("/examples/bracket.cndhf")));
    return made.map((geometry) => geometry.index.count);
  });
  assert.ok(triangles[0] > 0 && triangles[0] === triangles[1]);
  assert.ok(complaints.some((text) => /the page itself makes the meshes/.test(text)), String(complaints));
});

test("the viewer", { skip }, async (t) => {
  const { page, complaints } = await pageAt("dist/viewer.html");
  const open = async (path) => {
    await page.evaluate(() => (document.body.dataset.state = "busy"));
    await page.setInputFiles("#file", file(path));
    await settled(page);
  };
  const set = async (id, value) => {
    await page.evaluate(() => (document.body.dataset.state = "busy"));
    const control = page.locator(`#${id}`);
    if (typeof value === "boolean") await control.setChecked(value);
    else await control.selectOption(value);
    await settled(page);
  };
  const said = () => page.textContent("#status");
  const complained = () => page.textContent("#error");

  await t.test("opens files of both kinds, with everything shown", async () => {
    for (const path of ["spec/vectors/surface-creases.cndhf", "tests/golden/surface.cndhf", "examples/bracket.cndhf",
      "spec/vectors/dhf-zstd.cndhf"]) {
      await open(path);
      assert.equal(await complained(), "", path);
      assert.match(await said(), /\d+ triangles/);
      const isDhf = /bracket|\/dhf-/.test(path);
      for (const id of isDhf ? ["wireframe", "colours"] : ["wireframe", "control", "creases"]) await set(id, true);
      await shoot(page, path.split("/").pop());
      for (const id of isDhf ? ["wireframe", "colours"] : ["wireframe", "control", "creases"]) await set(id, false);
      assert.equal(await complained(), "", path);
    }
  });
  await t.test("draws from the weights", async () => {
    await set("mode", "march");
    assert.match(await said(), /from its weights/);
    await shoot(page, "march");
    await set("mode", "mesh");
  });
  await t.test("compares with the original", async () => {
    await open("examples/bracket.cndhf");
    await open("examples/bracket.ply");
    await shoot(page, "over");
    await set("original", "difference");
    assert.equal(await complained(), "");
    await shoot(page, "difference");
    await set("original", "none");
  });
  await t.test("downloads a GLB", async () => {
    const [download] = await Promise.all([page.waitForEvent("download"), page.click("#download")]);
    assert.equal(download.suggestedFilename(), "bracket.glb");
  });
  await t.test("is used by keyboard", async () => {
    const view = () => page.locator("#canvas").screenshot();
    const before = await view();
    await page.focus("#canvas");
    for (const key of ["ArrowLeft", "ArrowLeft", "ArrowUp", "+"]) await page.keyboard.press(key);
    assert.ok(!before.equals(await view()));
  });
  await t.test("every control has a name", async () => {
    const nameless = await page.evaluate(() =>
      [...document.querySelectorAll("input, select, button, canvas")]
        .filter((e) => !(e.labels?.length || e.textContent.trim() || e.getAttribute("aria-label"))).map((e) => e.id));
    assert.deepEqual(nameless, []);
  });
  await t.test("says what is wrong with a damaged file", async () => {
    await open("spec/vectors/refused/checksum-flipped.cndhf");
    assert.match(await complained(), /^ChecksumError: .*damaged/);
    await shoot(page, "damaged");
    assert.equal(await page.textContent("#facts"), ""); // nor is the shape before to be seen, or to be downloaded
    assert.ok(await page.isDisabled("#download"));
    await open("examples/bracket.cndhf");
    assert.equal(await complained(), "");
    assert.ok(await page.isEnabled("#download"));
  });
  assert.deepEqual(complaints, []);
});

test("the viewer opens ?url=", { skip }, async () => {
  const { page, complaints } = await pageAt("dist/viewer.html?url=/examples/bracket.cndhf");
  await settled(page);
  assert.match(await page.textContent("#status"), /bracket.cndhf: \d+ triangles/);
  await page.goto(new URL("dist/viewer.html?url=nowhere.cndhf", address).href);
  await settled(page);
  assert.match(await page.textContent("#error"), /404/);
  assert.deepEqual(complaints.filter((text) => !/404/.test(text)), []);
});

/** Run Python with this package; a process. */
const python = (...args) => spawn("python3", args, { cwd: file(""), stdio: ["ignore", "pipe", "inherit"] });
const noPython = skip || (spawnSync("python3", ["-c", "import cndhf_codec, click"], { cwd: file("") }).status
  ? "no Python with cndhf_codec" : false);

test("cndhf-view serves a file, and what is wrong with it", { skip: noPython }, async () => {
  for (const [path, wanted] of [["examples/bracket.cndhf", ""], ["spec/vectors/refused/checksum-flipped.cndhf", "ChecksumError"]]) {
    const command = python("-c", "from cndhf_codec import cli; cli.view()", file(path), "--no-browser");
    const [line] = await once(command.stdout, "data");
    const { page, complaints } = await pageAt(String(line).match(/http\S+/)[0]);
    await settled(page);
    await shoot(page, `view-${path.split("/").pop()}`);
    assert.equal((await page.textContent("#error")).split(":")[0], wanted);
    if (!wanted) assert.match(await page.textContent("#status"), /^bracket.cndhf: \d+ triangles/);
    assert.deepEqual(complaints, []);
    const ended = once(command, "exit");
    command.kill("SIGINT");
    assert.equal((await ended)[0], 0);
  }
});

test("a notebook's frame shows a model", { skip: noPython }, async () => {
  const code = 'import cndhf_codec; print(cndhf_codec.load("spec/vectors/surface-creases.cndhf").show()._repr_html_())';
  const html = (await python("-c", code).stdout.toArray()).join("");
  const { page, complaints } = await pageAt("dist/viewer.html");
  await page.setContent(html);
  const frame = await (await page.waitForSelector("iframe")).contentFrame();
  await settled(frame);
  await shoot(page, "frame");
  assert.match(await frame.textContent("#status"), /^model.cndhf: \d+ triangles/);
  const [download] = await Promise.all([page.waitForEvent("download"), frame.click("#download")]);
  assert.equal(download.suggestedFilename(), "model.glb");
  assert.deepEqual(complaints, []);
});

test("the examples render", { skip }, async () => {
  for (const name of ["three", "gltf"]) {
    const { page, complaints } = await pageAt(`examples/${name}.html`);
    await settled(page);
    await shoot(page, `example-${name}`);
    assert.deepEqual(complaints, [], name);
    const { triangles } = silhouettes["spec/vectors/surface-creases.cndhf"];
    if (name === "gltf") assert.equal(await page.evaluate(() => document.body.dataset.triangles), String(triangles));
  }
});
