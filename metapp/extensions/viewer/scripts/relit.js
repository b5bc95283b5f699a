// Photographs under many lamps, mixed for one lamp: a picture that stands beside the maps of a surface as their photograph.
//
// pictures: plane_0, ..., of which display values of the photograph under any lamp are weighted sums.
// arrays: weights [B S, S, 4], B blocks of four planes below one another: their weights under lamps in S x S directions; see
// table_directions in metapp.extensions.viewer.pages.relit.
// facts.relit: ranges [[low, high], ...], the values that 0 and 1 of each plane stand for; photos, their number.

const MIXED = (count) => `
precision highp float; precision highp sampler2D;
uniform sampler2D ${Array.from({ length: count }, (_, k) => `plane_${k}`).join(", ")};
uniform sampler2D weights, detail; uniform vec2 ranges[${count}]; uniform vec3 lamp; uniform float gain, body, highlight, power;
out vec4 result;
vec4 weights_at(vec3 direction, int block) {
  vec2 size = vec2(textureSize(weights, 0)), place = 0.5 + 0.5 * direction.xy / sqrt(max(1.0 + direction.z, 1e-6));
  return textureLod(weights, (0.5 + place * (size.x - 1.0) + vec2(0.0, float(block) * size.x)) / size, 0.0);
}
vec3 photo(vec3 direction) {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0.0);
  vec4 w;
${Array.from({ length: count }, (_, k) => `${k % 4 ? "" : `  w = weights_at(direction, ${k / 4});\n`}  sum += w[${k % 4}] * mix(vec3(ranges[${k}].x), vec3(ranges[${k}].y), texelFetch(plane_${k}, at, 0).rgb);`).join("\n")}
  return sum;
}
void main() {
  vec3 x_y_roughness = textureLod(detail, gl_FragCoord.xy / vec2(textureSize(plane_0, 0)), 0.0).rgb;
  vec2 slant = (x_y_roughness.xy * 255.0 - 128.0) / 127.0;
  vec3 n = normalize(vec3(slant, sqrt(max(1.0 - dot(slant, slant), 1e-4)))), shown = photo(lamp);
  // Malzbender et al. 2001: the value under the brightest lamp, along the normal, stays, and all derivatives about it grow
  if (gain != 1.0) shown = mix(photo(n), shown, gain);
  float lobe = pow(max(dot(n, normalize(lamp + vec3(0.0, 0.0, 1.0))), 0.0), power);
  result = vec4(clamp(body * shown + highlight * lobe, 0.0, 1.0), 1.0);
}`;

// The photographs of one fit under the viewer's lamp, as display values. `planes` and `detail` are textures.
class RelitPhotos {
  constructor(viewer, { ranges }, planes, detail, weights) {
    const { width, height } = planes[0].image;
    this.viewer = viewer; this.weights = weights;
    this.target = new THREE.WebGLRenderTarget(width, height, { minFilter: THREE.LinearMipmapLinearFilter, generateMipmaps: true, depthBuffer: false });
    this.material = viewer._pass(MIXED(planes.length), {
      ...Object.fromEntries(planes.map((plane, k) => [`plane_${k}`, plane])), weights, detail, ranges: ranges.map((range) => new THREE.Vector2(...range)),
      lamp: new THREE.Vector3(), gain: 1, body: 1, highlight: 0, power: 1,
    });
  }

  static async of(viewer, { facts, arrays }, planes, detail) {
    const { values, shape } = await numbersOf(arrays.weights);
    return new RelitPhotos(viewer, facts.relit, planes, detail, texture(values, shape[1], shape[0], LINEAR));
  }

  // Return the texture of the photographs under a lamp; settings are those of `relitControls`.
  under(lamp, { gain, body, highlight, power }) {
    const key = JSON.stringify([lamp, gain, body, highlight, power]), u = this.material.uniforms;
    if (key !== this.key) {
      u.lamp.value.copy(lamp);
      Object.entries({ gain, body, highlight, power }).forEach(([name, value]) => { u[name].value = value; });
      this.viewer._fill(this.material, this.target);
      this.key = key;
    }
    return this.target.texture;
  }

  free() { [this.target, this.material, this.weights].forEach((each) => each.dispose()); }
}

// Return the controls of photographs under a lamp, which are shown `when(settings)`, by the names that RTIViewer gives them.
function relitControls(when) {
  const share = { type: "range", min: 0, max: 1, step: 0.01, text: percent };
  return [
    { name: "gain", label: "Diffuse gain", type: "range", min: 1, max: 10, step: 0.1, value: 1, text: (x) => x.toFixed(1), when },
    { name: "highlight", label: "Specular enhancement (ks)", ...share, value: 0, when },
    { name: "body", label: "Share of the photos (kd)", ...share, value: 1, when },
    { name: "power", label: "Exponent of the highlight", type: "range", min: 1, max: 150, step: 1, value: 30, when: (s) => when(s) && s.highlight > 0 },
  ];
}
