/** The viewer page: opens files, draws them, and says what they hold. */
import {
  AmbientLight, BufferAttribute, BufferGeometry, Color, DirectionalLight, LineBasicMaterial, LineSegments, Mesh as Object,
  MeshStandardMaterial, type Object3D, PerspectiveCamera, Scene, Sphere, Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { toGlb } from "../src/glb.js";
import { decode, type Mesh, type Model } from "../src/index.js";
import { geometryOf } from "../src/three/geometry.js";
import { DhfRayMarch } from "../src/three/rayMarch.js";
import { factsOf } from "./facts.js";
import { controlLines, creaseLines } from "./lines.js";
import { NearestTriangle } from "./nearest.js";
import { readOriginal } from "./original.js";

const element = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;
const input = (id: string): HTMLInputElement => element(id);
const select = (id: string): HTMLSelectElement => element(id);

const TITLE = document.title;
const RESOLUTIONS = [32, 48, 64, 96, 128, 192, 256];
const DIFFERENCE = 0.005; // of the shape's radius: the distance of the last colour

const canvas = element<HTMLCanvasElement>("canvas");
const renderer = new WebGLRenderer({ canvas, antialias: true });
const scene = new Scene();
scene.background = new Color(0x20262d);
const ANGLE = 35; // degrees, of the picture's shorter side; the unit ball fits into it
const camera = new PerspectiveCamera(ANGLE, 1, 0.01, 100);
camera.position.set(1.65, 1.2, 2.85);
const orbit = new OrbitControls(camera, canvas);
orbit.addEventListener("change", draw);
camera.add(new DirectionalLight(0xffffff, 2.4));
scene.add(camera, new AmbientLight(0xffffff, 0.5));
/** Everything of the file, moved and scaled into the unit ball. */
const shape = new Object(new BufferGeometry());
scene.add(shape);

let model: Model | null = null;
let bytes: Uint8Array = new Uint8Array();
let name = "";
let mesh: Mesh | null = null;
let original: BufferGeometry | null = null;
let work = 0; // the last piece of work that was begun: older ones give up

function draw(): void {
  const { clientWidth: width, clientHeight: height } = canvas;
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(width, height, false);
  camera.aspect = width / Math.max(height, 1);
  // `fov` is that of the height.
  camera.fov = (360 / Math.PI) * Math.atan(Math.tan((ANGLE / 360) * Math.PI) / Math.min(camera.aspect || 1, 1));
  camera.updateProjectionMatrix();
  renderer.render(scene, camera);
}

function say(text: string): void {
  element("status").textContent = text;
}

function fail(error: unknown): void {
  const { name: kind, message } = error as Error;
  element("error").textContent = `${kind}: ${message}`;
  say("");
  document.body.dataset["state"] = "error";
}

/** Let the page show what was said. */
const pause = (): Promise<void> => new Promise((resolve) => setTimeout(resolve, 20));

async function open(fileName: string, data: ArrayBuffer, isMesh = /\.(ply|obj|stl)$/i.test(fileName)): Promise<void> {
  element("error").textContent = "";
  document.body.dataset["state"] = "busy";
  try {
    if (isMesh) {
      original = readOriginal(fileName, data);
      element("original-label").hidden = false;
      select("original").value = "over";
    } else {
      const opened = await decode(data).catch(forget);
      [model, bytes, name] = [opened, new Uint8Array(data), fileName];
      prepare(opened);
    }
    await show();
  } catch (error) {
    fail(error);
  }
}

/** After a file that cannot be read nothing of the one before stays: its shape under an error would be taken for it. */
function forget(error: unknown): never {
  work++;
  [model, bytes, name, mesh] = [null, new Uint8Array(), "", null];
  clear();
  addOriginal();
  draw();
  fill([]);
  element<HTMLFieldSetElement>("settings").disabled = true;
  element("hint").hidden = false;
  document.title = TITLE;
  throw error;
}

/** Set the controls for a file that was opened. */
function prepare(opened: Model): void {
  const isDhf = opened.representation === "dhf";
  element("hint").hidden = true;
  element<HTMLFieldSetElement>("settings").disabled = false;
  document.title = `${name} – ${TITLE}`;
  select("mode").value = "mesh";
  select("mode").options[1]!.disabled = !isDhf;
  element("detail-name").textContent = isDhf ? "Cells along the longest side" : "Level of subdivision";
  const detail = input("detail");
  detail.min = "0";
  if (opened.representation === "dhf") {
    detail.max = String(RESOLUTIONS.length - 1);
    detail.value = String(RESOLUTIONS.indexOf(96));
    input("fields").max = input("fields").value = String(opened.fields.length);
  } else {
    const nFaces = opened.control.faces.length / 3;
    const finest = Math.max(0, Math.min(5, Math.floor(Math.log2(2 ** 20 / nFaces) / 2)));
    detail.max = String(finest);
    detail.value = String(Math.max(0, Math.min(finest, Math.floor(Math.log2(2 ** 17 / nFaces) / 2))));
  }
  element("fields-label").hidden = !isDhf;
  for (const id of ["control", "creases"]) input(id).disabled = isDhf;
  input("colours").disabled = !isDhf;
}

/** Make and draw what the controls say. */
async function show(): Promise<void> {
  const mine = ++work;
  document.body.dataset["state"] = "busy";
  element("error").textContent = "";
  if (!model) {
    if (original) frame(original);
    return finish(mine, "Now open a .cndhf file");
  }
  say("Working …");
  await pause();
  if (mine !== work) return;
  try {
    const level = Number(input("detail").value);
    let shown = model;
    let options: object = { level };
    if (model.representation === "dhf") {
      shown = model.first(Number(input("fields").value));
      options = { resolution: RESOLUTIONS[level] };
    }
    element("detail-value").textContent = String(model.representation === "dhf" ? RESOLUTIONS[level] : level);
    element("fields-value").textContent = input("fields").value;
    const marches = select("mode").value === "march" && shown.representation === "dhf";
    const made = marches ? null : await (shown.toMesh as (o: object) => Promise<Mesh>)(options).catch(fail);
    if (mine !== work || made === undefined) return;
    mesh = made;
    clear();
    if (mesh) addMesh(shown, mesh);
    else if (shown.representation === "dhf") shape.add(new DhfRayMarch(shown));
    addOriginal();
    frame(mesh && !shape.userData["framed"] ? geometryOf(mesh) : null);
    fill(factsOf(model, mesh));
    finish(mine, mesh ? `${name}: ${mesh.index.length / 3} triangles` : `${name}: drawn from its weights`);
  } catch (error) {
    fail(error);
  }
}

function finish(mine: number, text: string): void {
  if (mine !== work) return;
  draw();
  say(text);
  document.body.dataset["state"] = "ready";
}

function clear(): void {
  for (const child of [...shape.children] as Object3D[]) {
    shape.remove(child);
    if (child instanceof DhfRayMarch) child.dispose();
    else if (child instanceof Object || child instanceof LineSegments) (child.geometry as BufferGeometry).dispose();
  }
}

function addMesh(shown: Model, made: Mesh): void {
  const geometry = geometryOf(made);
  const colours = coloursOf(shown, made);
  if (colours) geometry.setAttribute("color", new BufferAttribute(colours, 3));
  const material = new MeshStandardMaterial({
    color: colours ? 0xffffff : 0xb8c4d0, vertexColors: colours !== null, roughness: 0.75, metalness: 0, side: 2,
  });
  const parts: Object3D[] = [new Object(geometry, material)];
  if (input("wireframe").checked) {
    parts.push(new Object(geometry, new MeshStandardMaterial({ wireframe: true, color: 0x111820 })));
    material.polygonOffset = true;
    material.polygonOffsetFactor = material.polygonOffsetUnits = 1;
  }
  if (shown.representation === "surface") {
    if (input("control").checked) {
      parts.push(new LineSegments(controlLines(shown, made.origin), new LineBasicMaterial({ color: 0xf2b33d })));
    }
    if (input("creases").checked) {
      parts.push(new LineSegments(creaseLines(made), new LineBasicMaterial({ color: 0xff5964 })));
    }
  }
  for (const part of parts) {
    part.position.fromArray(made.origin);
    shape.add(part);
  }
}

/** Colours of vertices: by the field that each lies on, or by the distance from the original; null for none. */
function coloursOf(shown: Model, made: Mesh): Float32Array | null {
  const n = made.positions.length / 3;
  const out = new Float32Array(3 * n);
  const color = new Color();
  if (original && select("original").value === "difference") {
    original.computeBoundingBox();
    const { min, max } = original.boundingBox!;
    const nearest = new NearestTriangle(original.getAttribute("position").array, original.index!.array, min, max);
    const most = DIFFERENCE * max.distanceTo(min);
    const point = new Vector3();
    for (let v = 0; v < n; v++) {
      point.fromArray(made.positions, 3 * v).add(new Vector3(...made.origin));
      const share = nearest.distance(point, most) / most;
      color.setHSL((1 - share) * 0.6, 0.75, 0.5).toArray(out, 3 * v);
    }
    return out;
  }
  if (!input("colours").checked || shown.representation !== "dhf") return null;
  const points = Float64Array.from(made.positions, (x, i) =>
    (x + made.origin[i % 3]! - shown.centre[i % 3]!) / shown.scale);
  const least = new Float64Array(n).fill(Infinity);
  shown.fields.forEach((field, k) => {
    color.setHSL(k * 0.618 % 1, 0.55, 0.6);
    field.implicit(points).forEach((f, v) => {
      if (f >= least[v]!) return;
      least[v] = f;
      color.toArray(out, 3 * v);
    });
  });
  return out;
}

function addOriginal(): void {
  if (!original || select("original").value !== "over") return;
  const material = new MeshStandardMaterial({ color: 0xf2b33d, transparent: true, opacity: 0.45, depthWrite: false });
  shape.add(new Object(original.clone(), material));
}

/** Bring a geometry into the unit ball. */
function frame(geometry: BufferGeometry | null): void {
  if (geometry) {
    geometry.computeBoundingSphere();
    const { center, radius } = geometry.boundingSphere ?? new Sphere();
    center.add(new Vector3(...((geometry.userData["origin"] as number[] | undefined) ?? [0, 0, 0])));
    shape.scale.setScalar(1 / (radius || 1));
    shape.userData["centre"] = center;
    shape.userData["framed"] = true;
  }
  const centre = (shape.userData["centre"] as Vector3 | undefined) ?? new Vector3();
  shape.rotation.set(select("up").value === "Z" ? -Math.PI / 2 : 0, 0, 0);
  shape.position.copy(centre).multiplyScalar(-shape.scale.x).applyEuler(shape.rotation);
}

function fill(rows: [string, string][]): void {
  const body = element("facts").firstElementChild!;
  body.replaceChildren(...rows.map(([head, value]) => {
    const row = document.createElement("tr");
    const th = document.createElement("th");
    const td = document.createElement("td");
    th.scope = "row";
    th.textContent = head;
    td.textContent = value;
    row.append(th, td);
    return row;
  }));
}

async function openFiles(files: Iterable<File>): Promise<void> {
  const sorted = [...files].sort((a, b) => Number(b.name.endsWith(".cndhf")) - Number(a.name.endsWith(".cndhf")));
  for (const file of sorted) {
    if (file.name.endsWith(".cndhf")) shape.userData["framed"] = false;
    await open(file.name, await file.arrayBuffer());
  }
}

function turn(event: KeyboardEvent): void {
  const steps: Record<string, [number, number, number]> = {
    ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1],
    "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1 / 0.9],
  };
  if (event.key === "0") orbit.reset();
  const step = steps[event.key];
  if (!step) return;
  event.preventDefault();
  const at = new Spherical().setFromVector3(camera.position.clone().sub(orbit.target));
  at.theta += step[0];
  at.phi += step[1];
  at.radius *= step[2];
  camera.position.setFromSpherical(at.makeSafe()).add(orbit.target);
  orbit.update();
}

for (const id of ["mode", "detail", "fields", "wireframe", "control", "creases", "colours", "up", "original"]) {
  element(id).addEventListener("change", () => void show());
}
element("file").addEventListener("change", () => void openFiles(input("file").files!));
element("download").addEventListener("click", () => void (async () => {
  const made = mesh ?? (await model!.toMesh());
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([toGlb(made, { embed: bytes }) as BlobPart], { type: "model/gltf-binary" }));
  link.download = name.replace(/(\.cndhf)?$/, ".glb");
  link.click();
  URL.revokeObjectURL(link.href);
})());
canvas.addEventListener("keydown", turn);
addEventListener("resize", draw);
const stage = element("stage");
for (const [type, isOver] of [["dragover", true], ["dragleave", false], ["drop", false]] as const) {
  document.body.addEventListener(type, (event) => {
    event.preventDefault();
    stage.classList.toggle("over", isOver);
    if (type === "drop") void openFiles(event.dataTransfer?.files ?? []);
  });
}
draw();

const inside = element("cndhf-file").textContent?.trim();
const url = new URLSearchParams(location.search).get("url");
if (inside) {
  const data = Uint8Array.from(atob(inside), (c) => c.charCodeAt(0));
  void open(element("cndhf-file").dataset["name"] ?? "shape.cndhf", data.buffer, false);
} else if (url) {
  fetch(url).then(async (response) => {
    if (!response.ok) throw new Error(`${url}: ${response.status} ${response.statusText}`);
    await open(url.split("/").pop()!, await response.arrayBuffer());
  }).catch(fail);
}
