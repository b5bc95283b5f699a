// Light maps as textures, and shapes to put materials on.

THREE.ColorManagement.enabled = false;
const LINEAR = { minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter };
const NEAREST = { minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };

// A texture of numbers, four a texel.
function texture(values, width, height, options = {}) {
  const half = values instanceof Uint16Array;
  const made = new THREE.DataTexture(values, width, height, THREE.RGBAFormat, half ? THREE.HalfFloatType : THREE.FloatType);
  Object.assign(made, { ...NEAREST, ...options, needsUpdate: true });
  return made;
}

// A light map [H, W, 3] for shaders: radiance, in the fourth channel luminance times the sine of the polar angle;
// and places drawn by that over the map. Where the reference has a light of its own, the luminance is the mean of both.
function lightOf(values, height, width, reference = values) {
  const half = (x) => THREE.DataUtils.toHalfFloat(clamp(x, 0, 65504));
  const sums = new Float64Array(height * width), [texels, others] = [0, 1].map(() => new Uint16Array(4 * height * width));
  let total = 0;
  for (let i = 0; i < height * width; i++) {
    const row = Math.floor(i / width);
    const solidAngle = (Math.cos(Math.PI * row / height) - Math.cos(Math.PI * (row + 1) / height)) * 2 * Math.PI / width;
    let luminance = 1e-6;
    for (let c = 0; c < 3; c++) {
      texels[4 * i + c] = half(values[3 * i + c]);
      others[4 * i + c] = half(reference[3 * i + c]);
      luminance += [0.2126, 0.7152, 0.0722][c] * (clamp(values[3 * i + c], 0, 65504) + clamp(reference[3 * i + c], 0, 65504)) / 2;
    }
    texels[4 * i + 3] = half(luminance * solidAngle * height * width / (2 * Math.PI ** 2));
    sums[i] = total += luminance * solidAngle;
  }
  const places = new Float32Array(4 * 8192);
  for (let i = 0, at = 0; i < 8192; i++) {
    while (sums[at] < (i + 0.5) / 8192 * total && at < sums.length - 1) at++;
    places[4 * i] = at % width; places[4 * i + 1] = Math.floor(at / width);
  }
  const mean = total / (4 * Math.PI), around = { ...LINEAR, wrapS: THREE.RepeatWrapping }, map = texture(texels, width, height, around);
  return { map, reference: reference === values ? map : texture(others, width, height, around), places: texture(places, 8192, 1),
    size: new THREE.Vector2(width, height), total, scale: 0.5 / mean };
}

// Gives up the textures of a light.
function forget(light) { Object.values(light).forEach((part) => { if (part?.isTexture) part.dispose(); }); }

// A grid of [u, v] in [0, 1] on a surface, with normals and tangents by differences.
function parametric(place, across, down) {
  const count = (across + 1) * (down + 1), arrays = { position: [3], normal: [3], tangent: [3], uv: [2] };
  for (const [name, [size]] of Object.entries(arrays)) arrays[name] = new THREE.BufferAttribute(new Float32Array(count * size), size);
  const point = (u, v) => new THREE.Vector3(...place(u, v)), step = 1e-3;
  for (let j = 0, k = 0; j <= down; j++) {
    for (let i = 0; i <= across; i++, k++) {
      const u = i / across, v = j / down, inner = clamp(v, step * 2, 1 - step * 2);
      const along = point(u + step, inner).sub(point(u - step, inner)).normalize();
      const up = point(u, inner + step).sub(point(u, inner - step));
      const normal = new THREE.Vector3().crossVectors(along, up).normalize();
      arrays.position.setXYZ(k, ...place(u, v));
      arrays.normal.setXYZ(k, normal.x, normal.y, normal.z);
      arrays.tangent.setXYZ(k, along.x, along.y, along.z);
      arrays.uv.setXY(k, u, v);
    }
  }
  const index = [];
  for (let j = 0; j < down; j++) {
    for (let i = 0; i < across; i++) {
      const a = j * (across + 1) + i, b = a + across + 1;
      index.push(a, a + 1, b, b, a + 1, b + 1);
    }
  }
  const geometry = new THREE.BufferGeometry();
  for (const [name, attribute] of Object.entries(arrays)) geometry.setAttribute(name, attribute);
  geometry.setIndex(index);
  return geometry;
}

function sphere() {  // exact normals; tangents lie horizontally, as in metapp's pictures
  const made = parametric((u, v) => {
    const phi = 2 * Math.PI * u, theta = Math.PI * (1 - v);
    return [Math.sin(theta) * Math.sin(phi), Math.cos(theta), Math.sin(theta) * Math.cos(phi)];
  }, 192, 96);
  const { position, normal, tangent } = made.attributes;
  normal.array.set(position.array);
  for (let k = 0; k < position.count; k++) {
    const x = position.getX(k), z = position.getZ(k), length = Math.hypot(x, z) || 1;
    tangent.setXYZ(k, z / length || 1, 0, -x / length);
  }
  return made;
}

const SHAPES = {
  sphere: ["Sphere", sphere],
  plane: ["Plane", () => parametric((u, v) => [2 * u - 1, 2 * v - 1, 0], 256, 256)],
  cylinder: ["Cylinder", () => parametric((u, v) => [0.7 * Math.sin(2 * Math.PI * u), 2 * v - 1, 0.7 * Math.cos(2 * Math.PI * u)], 256, 256)],
  cloth: ["Draped cloth", () => parametric((u, v) => {
    const x = 2.4 * u - 1.2, y = 2.4 * v - 1.2, r = Math.hypot(x, y);
    const over = r < 0.6 ? Math.sqrt(1 - r * r) : Math.max(0.8 - 0.75 * (r - 0.6), -0.1);
    const fold = clamp((r - 0.5) / 0.6, 0, 1) ** 2 * 0.16 * Math.cos(9 * Math.atan2(y, x));
    return [x, y, over + fold - 0.4];
  }, 256, 256)],
  knot: ["Bent tube", () => parametric((u, v) => {
    const t = 2 * Math.PI * u, around = 2 * Math.PI * v;
    const centre = (a) => [0.5 * (Math.sin(a) + 2 * Math.sin(2 * a)) * 0.55, 0.5 * (Math.cos(a) - 2 * Math.cos(2 * a)) * 0.55, -0.4 * Math.sin(3 * a)];
    const at = new THREE.Vector3(...centre(t)), ahead = new THREE.Vector3(...centre(t + 1e-3)).sub(at).normalize();
    const side = new THREE.Vector3(0.1, 0.2, 1).cross(ahead).normalize(), up = new THREE.Vector3().crossVectors(ahead, side);
    at.addScaledVector(side, 0.26 * Math.cos(around)).addScaledVector(up, 0.26 * Math.sin(around));
    return at.toArray();
  }, 384, 48)],
};
const builtShapes = {};
const shapeOf = (name) => (builtShapes[name] ??= SHAPES[name][1]());
