/**
 * Draws double height fields straight from their weights, without a mesh.
 *
 * The graphics card evaluates each network once, into an image of heights over the field's plane (`BAKE`). From then on
 * each pixel of the solid walks along its ray until f changes sign (`MARCH`), which looks heights up in these images.
 */
import {
  BackSide, BoxGeometry, type Camera, Color, type ColorRepresentation, DataTexture, FloatType, Matrix4, Mesh, NearestFilter,
  OrthographicCamera, RedFormat, RGBAFormat, RGFormat, type Scene, ShaderMaterial, type WebGLRenderer,
  WebGLArrayRenderTarget, Vector3,
} from "three";
import type { DhfModel, Field } from "../index.js";

const TEXELS = 1024; // per row of the texture of weights

const BAKE = /* glsl */ `
  precision highp float;
  uniform highp sampler2D weights;
  uniform int first; // weight of the field
  uniform int width;
  uniform int hiddenLayers;
  uniform vec2 omega;
  uniform vec4 box; // u min, u max, v min, v max
  uniform vec2 fold;
  uniform float size;

  float weight(int i) { return texelFetch(weights, ivec2(i % ${TEXELS}, i / ${TEXELS}), 0).r; }

  // Graphics cards are only exact near 0.
  float sine(float x) { return sin(x - 6.283185307179586 * floor(x / 6.283185307179586 + 0.5)); }

  void main() {
    vec2 uv = mix(box.xz, box.yw, (gl_FragCoord.xy - 0.5) / (size - 1.0));
    vec2 middle = 0.5 * (box.xz + box.yw);
    uv = mix(uv, middle + abs(uv - middle), fold);
    float x[WIDTH];
    float y[WIDTH];
    int at = first;
    for (int i = 0; i < width; i++) {
      x[i] = sine(omega.x * (weight(at + 2 * i) * uv.x + weight(at + 2 * i + 1) * uv.y + weight(at + 2 * width + i)));
    }
    at += 3 * width;
    for (int layer = 0; layer < hiddenLayers; layer++) {
      for (int i = 0; i < width; i++) {
        float sum = weight(at + width * width + i);
        for (int j = 0; j < width; j++) sum += weight(at + width * i + j) * x[j];
        y[i] = sine(omega.y * sum);
      }
      for (int i = 0; i < width; i++) x[i] = y[i];
      at += width * (width + 1);
    }
    vec2 heights = vec2(weight(at + 2 * width), weight(at + 2 * width + 1));
    for (int j = 0; j < width; j++) heights += x[j] * vec2(weight(at + j), weight(at + width + j));
    gl_FragColor = vec4(heights, 0.0, 1.0);
  }
`;

const MARCH_VERTEX = /* glsl */ `
  varying vec4 clip;
  void main() {
    clip = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    gl_Position = clip;
  }
`;

const MARCH = /* glsl */ `
  precision highp float;
  precision highp sampler2DArray;
  uniform sampler2DArray heights;
  uniform highp sampler2D fields; // per field: three rows of its rotation, least and greatest corner of its box
  uniform float size;
  uniform int steps;
  uniform vec3 color;
  uniform mat4 toLocal; // from the screen
  uniform mat4 toClip;
  uniform vec3 low;
  uniform vec3 high;
  varying vec4 clip;

  vec2 heightsAt(int k, vec2 at) {
    vec2 place = clamp(at, 0.0, 1.0) * (size - 1.0);
    ivec2 i = ivec2(min(floor(place), size - 2.0));
    vec2 t = place - vec2(i);
    vec2 a = mix(texelFetch(heights, ivec3(i, k), 0).rg, texelFetch(heights, ivec3(i + ivec2(1, 0), k), 0).rg, t.x);
    vec2 b = mix(
      texelFetch(heights, ivec3(i + ivec2(0, 1), k), 0).rg, texelFetch(heights, ivec3(i + ivec2(1, 1), k), 0).rg, t.x);
    return mix(a, b, t.y);
  }

  mat3 rotation(int k) {
    return transpose(mat3(
      texelFetch(fields, ivec2(0, k), 0).xyz, texelFetch(fields, ivec2(1, k), 0).xyz,
      texelFetch(fields, ivec2(2, k), 0).xyz));
  }

  float least(vec3 v) { return min(v.x, min(v.y, v.z)); }

  // f of field k, as in the file format.
  float field(int k, vec3 p) {
    vec3 uvz = rotation(k) * p;
    vec3 start = texelFetch(fields, ivec2(3, k), 0).xyz;
    vec3 end = texelFetch(fields, ivec2(4, k), 0).xyz;
    float walls = min(least(uvz - start), least(end - uvz));
    vec2 h = heightsAt(k, (uvz.xy - start.xy) / (end.xy - start.xy));
    return min(walls, min(h.y - uvz.z, uvz.z - h.x));
  }

  float f(vec3 p) {
    float value = 1e9;
    for (int k = 0; k < FIELDS; k++) value = min(value, field(k, p));
    return value;
  }

  // Outward, of the term of f that is least.
  vec3 normalAt(vec3 p) {
    int owner = 0;
    float value = 1e9;
    for (int k = 0; k < FIELDS; k++) {
      float fk = field(k, p);
      if (fk < value) { value = fk; owner = k; }
    }
    mat3 r = rotation(owner);
    vec3 uvz = r * p;
    vec3 start = texelFetch(fields, ivec2(3, owner), 0).xyz;
    vec3 end = texelFetch(fields, ivec2(4, owner), 0).xyz;
    vec2 at = (uvz.xy - start.xy) / (end.xy - start.xy);
    vec2 cell = vec2(1.0 / (size - 1.0), 0.0);
    vec2 h = heightsAt(owner, at);
    vec2 du = (heightsAt(owner, at + cell) - heightsAt(owner, at - cell)) / (2.0 * cell.x * (end.x - start.x));
    vec2 dv = (heightsAt(owner, at + cell.yx) - heightsAt(owner, at - cell.yx)) / (2.0 * cell.x * (end.y - start.y));
    vec3 n = h.y - uvz.z < uvz.z - h.x ? vec3(-du.y, -dv.y, 1.0) : vec3(du.x, dv.x, -1.0);
    vec3 below = uvz - start;
    vec3 above = end - uvz;
    if (min(least(below), least(above)) <= value + 1e-6) {
      float wall = min(least(below), least(above));
      n = vec3(lessThanEqual(above, vec3(wall))) - vec3(lessThanEqual(below, vec3(wall)));
    }
    return normalize(transpose(r) * n);
  }

  void main() {
    vec2 screen = clip.xy / clip.w;
    vec4 near = toLocal * vec4(screen, -1.0, 1.0);
    vec4 far = toLocal * vec4(screen, 1.0, 1.0);
    vec3 origin = near.xyz / near.w;
    vec3 direction = normalize(far.xyz / far.w - origin);
    vec3 a = (low - origin) / direction;
    vec3 b = (high - origin) / direction;
    vec3 first = min(a, b);
    vec3 last = max(a, b);
    float t = max(max(first.x, max(first.y, first.z)), 0.0);
    float end = least(last);
    float dt = length(high - low) / float(steps);
    float before = t;
    float value = -1.0;
    for (int i = 0; i < steps && t < end; i++) {
      value = f(origin + t * direction);
      if (value >= 0.0) break;
      before = t;
      t += clamp(-0.4 * value, dt, 8.0 * dt); // f is no distance where heights are steep
    }
    if (value < 0.0) discard;
    for (int i = 0; i < 10; i++) {
      float middle = 0.5 * (before + t);
      if (f(origin + middle * direction) >= 0.0) t = middle; else before = middle;
    }
    vec3 p = origin + t * direction;
    float light = abs(dot(normalAt(p), direction));
    gl_FragColor = vec4(color * (0.15 + 0.85 * light), 1.0);
    vec4 c = toClip * vec4(p, 1.0);
    gl_FragDepth = 0.5 + 0.5 * c.z / c.w;
    #include <colorspace_fragment>
  }
`;

export interface RayMarchOptions {
  color?: ColorRepresentation;
  /** Pixels along the sides of the images of heights: 256 by default. */
  size?: number;
  /** Steps through the solid's box, at most: 160 by default. */
  steps?: number;
}

/** An object of a three.js scene. It is lit from the camera; other lights do not reach it. Needs WebGL 2. */
export class DhfRayMarch extends Mesh<BoxGeometry, ShaderMaterial> {
  private readonly fields: Field[];
  private readonly size: number;
  private target: WebGLArrayRenderTarget | null = null;

  constructor(model: DhfModel, { color = 0xb8c4d0, size = 256, steps = 160 }: RayMarchOptions = {}) {
    const [low, high] = boxOf(model.fields);
    const sides = high.clone().sub(low);
    const geometry = new BoxGeometry(sides.x, sides.y, sides.z);
    geometry.translate(...low.clone().add(high).multiplyScalar(0.5).toArray());
    super(geometry, new ShaderMaterial({
      vertexShader: MARCH_VERTEX,
      fragmentShader: MARCH,
      defines: { FIELDS: model.fields.length },
      side: BackSide, // so that the camera may be inside the box
      uniforms: {
        heights: { value: null },
        fields: { value: fieldTexture(model.fields) },
        size: { value: size },
        steps: { value: steps },
        color: { value: new Color(color) },
        toLocal: { value: new Matrix4() },
        toClip: { value: new Matrix4() },
        low: { value: low },
        high: { value: high },
      },
    }));
    this.fields = model.fields;
    this.size = size;
    this.position.fromArray(model.centre);
    this.scale.setScalar(model.scale);
  }

  override onBeforeRender = (renderer: WebGLRenderer, _scene: Scene, camera: Camera): void => {
    this.target ??= bake(renderer, this.fields, this.size);
    const { uniforms } = this.material;
    uniforms["heights"]!.value = this.target.texture;
    const toClip = uniforms["toClip"]!.value as Matrix4;
    toClip.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).multiply(this.matrixWorld);
    (uniforms["toLocal"]!.value as Matrix4).copy(toClip).invert();
    this.material.uniformsNeedUpdate = true;
  };

  override dispose(): void {
    super.dispose();
    this.target?.dispose();
    (this.material.uniforms["fields"]!.value as DataTexture).dispose();
    this.geometry.dispose();
    this.material.dispose();
  }
}

/** A box around the solid in the normalised frame: the intersection of boxes around the fields' own. */
function boxOf(fields: Field[]): [Vector3, Vector3] {
  const low = new Vector3().setScalar(-Infinity);
  const high = new Vector3().setScalar(Infinity);
  for (const { rotation: r, record: { box } } of fields) {
    for (let k = 0; k < 3; k++) {
      const corners = Array.from({ length: 8 }, (_, c) =>
        r[k]! * box[c & 1]! + r[3 + k]! * box[2 + ((c >> 1) & 1)]! + r[6 + k]! * box[4 + (c >> 2)]!);
      low.setComponent(k, Math.max(low.getComponent(k), Math.min(...corners)));
      high.setComponent(k, Math.min(high.getComponent(k), Math.max(...corners)));
    }
  }
  return [low.min(high), high];
}

function fieldTexture(fields: Field[]): DataTexture {
  const data = new Float32Array(20 * fields.length);
  fields.forEach(({ rotation, record: { box } }, k) => {
    for (let i = 0; i < 9; i++) data[20 * k + 4 * Math.floor(i / 3) + (i % 3)] = rotation[i]!;
    for (let i = 0; i < 3; i++) {
      data[20 * k + 12 + i] = box[2 * i]!;
      data[20 * k + 16 + i] = box[2 * i + 1]!;
    }
  });
  const texture = new DataTexture(data, 5, fields.length, RGBAFormat, FloatType);
  texture.needsUpdate = true;
  return texture;
}

/** An image of near and far heights per field. */
function bake(renderer: WebGLRenderer, fields: Field[], size: number): WebGLArrayRenderTarget {
  const starts: number[] = [];
  let total = 0;
  for (const { tensors } of fields) {
    starts.push(total);
    total += tensors.reduce((sum, t) => sum + t.length, 0);
  }
  const data = new Float32Array(TEXELS * Math.ceil(total / TEXELS));
  fields.flatMap((field) => field.tensors).reduce((at, tensor) => {
    data.set(tensor, at);
    return at + tensor.length;
  }, 0);
  const weights = new DataTexture(data, TEXELS, data.length / TEXELS, RedFormat, FloatType);
  weights.needsUpdate = true;
  const target = new WebGLArrayRenderTarget(size, size, fields.length, {
    format: RGFormat, type: FloatType, minFilter: NearestFilter, magFilter: NearestFilter, depthBuffer: false,
  });
  const material = new ShaderMaterial({
    vertexShader: "void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }",
    fragmentShader: BAKE,
    defines: { WIDTH: Math.max(...fields.map(({ record }) => record.width)) },
    depthTest: false,
    uniforms: {
      weights: { value: weights }, first: { value: 0 }, width: { value: 0 }, hiddenLayers: { value: 0 },
      omega: { value: [0, 0] }, box: { value: [0, 0, 0, 0] }, fold: { value: [0, 0] }, size: { value: size },
    },
  });
  const square = new Mesh(new BoxGeometry(2, 2, 0), material);
  square.frustumCulled = false;
  const camera = new OrthographicCamera();
  const { autoClear } = renderer;
  const previous = renderer.getRenderTarget();
  const layer = renderer.getActiveCubeFace();
  renderer.autoClear = false;
  fields.forEach(({ record: r }, k) => {
    const values = {
      first: starts[k], width: r.width, hiddenLayers: r.hiddenLayers, omega: [r.omegaFirst, r.omegaHidden],
      box: r.box.slice(0, 4), fold: [r.fold & 1, r.fold >> 1],
    };
    for (const [name, value] of Object.entries(values)) material.uniforms[name]!.value = value;
    material.uniformsNeedUpdate = true;
    renderer.setRenderTarget(target, k);
    renderer.render(square, camera);
  });
  renderer.setRenderTarget(previous, layer);
  renderer.autoClear = autoClear;
  weights.dispose();
  square.geometry.dispose();
  material.dispose();
  return target;
}
