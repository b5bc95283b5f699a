// Light maps as textures, and shapes that materials are shown on.

THREE.ColorManagement.enabled = false;
const LINEAR = { minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter };
const AROUND = { ...LINEAR, wrapS: THREE.RepeatWrapping };  // options of textures of light maps, which wrap around
const NEAREST = { minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };

// Return a texture of numbers, four a texel.
function texture(values, width, height, options = {}) {
  const half = values instanceof Uint16Array;
  const made = new THREE.DataTexture(values, width, height, THREE.RGBAFormat, half ? THREE.HalfFloatType : THREE.FloatType);
  Object.assign(made, { ...NEAREST, ...options, needsUpdate: true });
  return made;
}

// Return a light map [H, W, 3] for shaders: radiance, in the fourth channel luminance times the sine of the polar angle, and
// places that are sampled in proportion to it. If the reference has a light of its own, the luminance is the mean of both.
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
  const mean = total / (4 * Math.PI), same = reference === values, [map, matte] = blurred(texels, values, width, height);
  const [other, otherMatte] = same ? [map, matte] : blurred(others, reference, width, height);
  return { map, matte, reference: other, referenceMatte: otherMatte, places: texture(places, 8192, 1), size: new THREE.Vector2(width, height), total, scale: 0.5 / mean };
}

// Return a map with levels that are blurred uniformly over the sphere, each with half as many texels across, and its mean over
// the cosine about each direction.
function blurred(texels, values, width, height) {
  const mipmaps = [{ data: texels, width, height }];
  let level = { values: Float32Array.from(values, (x) => clamp(x, 0, 65504)), width, height }, small = level;
  while (level.height >= 8 && level.width >= 8) {
    level = halved(level);
    mipmaps.push({ data: fourHalves(level.values), width: level.width, height: level.height });
    if (small.height > 32) small = level;
  }
  const map = texture(texels, width, height, { ...AROUND, minFilter: THREE.LinearMipmapLinearFilter });
  map.mipmaps = mipmaps;
  return [map, texture(fourHalves(overCosine(small, 32, 16)), 32, 16, AROUND)];
}

function fourHalves(values) {
  const texels = new Uint16Array(values.length / 3 * 4);
  for (let i = 0, k = 0; i < values.length; i += 3, k += 4) for (let c = 0; c < 3; c++) texels[k + c] = THREE.DataUtils.toHalfFloat(Math.min(values[i + c], 65504));
  return texels;
}

// Return the mean over a tent of two rows either way, and in each row over two texels at the equator, more towards the poles.
function halved({ values, width, height }) {
  const wide = Math.floor(width / 2), high = Math.floor(height / 2), result = new Float32Array(3 * wide * high), sums = new Float64Array(3 * (width + 1));
  const sine = (row, rows) => Math.sin(Math.PI * (row + 0.5) / rows), totals = new Float64Array(high);
  for (let row = 0; row < height; row++) {
    for (let x = 0; x < width; x++) for (let c = 0; c < 3; c++) sums[3 * (x + 1) + c] = sums[3 * x + c] + values[3 * (row * width + x) + c];
    const upTo = (x, c) => {  // the sum of the row from 0 to a place, which may lie beyond its end
      const rounds = Math.floor(x / width), at = x - rounds * width, first = Math.floor(at), i = 3 * first + c;
      return rounds * sums[3 * width + c] + sums[i] + (first < width ? (at - first) * (sums[i + 3] - sums[i]) : 0);
    };
    for (let y = Math.max(Math.floor((row - 2) * high / height), 0); y < high; y++) {
      const weight = (1 - Math.abs(row + 0.5 - (y + 0.5) * height / high) / 2) * sine(row, height);
      if ((y + 0.5) * height / high - row > 3) break;
      if (weight <= 0) continue;
      const half = Math.min(1 / sine(y, high), width / 2);
      totals[y] += weight;
      for (let x = 0; x < wide; x++) {
        const at = (x + 0.5) * width / wide;
        for (let c = 0; c < 3; c++) result[3 * (y * wide + x) + c] += weight * (upTo(at + half, c) - upTo(at - half, c)) / (2 * half);
      }
    }
  }
  for (let i = 0; i < result.length; i++) result[i] /= totals[Math.floor(i / 3 / wide)];
  return { values: result, width: wide, height: high };
}

function overCosine({ values, width, height }, wide, high) {
  const result = new Float32Array(3 * wide * high), total = new Float64Array(4);
  const places = (w, h) => Array.from({ length: w * h }, (_, i) => {
    const phi = 2 * Math.PI * (i % w + 0.5) / w, theta = Math.PI * (Math.floor(i / w) + 0.5) / h;
    return [Math.sin(theta) * Math.sin(phi), Math.cos(theta), -Math.sin(theta) * Math.cos(phi), Math.sin(theta)];
  });
  const lights = places(width, height);
  places(wide, high).forEach(([x, y, z], i) => {
    total.fill(0);
    lights.forEach(([lx, ly, lz, area], k) => {
      const weight = area * Math.max(x * lx + y * ly + z * lz, 0);
      total[3] += weight;
      for (let c = 0; c < 3; c++) total[c] += weight * values[3 * k + c];
    });
    for (let c = 0; c < 3; c++) result[3 * i + c] = total[c] / total[3];
  });
  return result;
}

// Free the textures of a light.
function forget(light) { Object.values(light).forEach((part) => { if (part?.isTexture) part.dispose(); }); }

// Return a surface over a grid of [u, v] in [0, 1], with normals and tangents by differences.
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

function sphere() {  // with exact normals; tangents are horizontal, as in metapp's pictures
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
