// Polar plots of a BRDF in a plane: the fit, the reference and samples, with angles, units and a legend.

const PLOT = [300, 258], LINES = { fit: "#ffffff", reference: "#7fb2ff", seen: "#ffd76a" };

// Plot reflectance, the mean of RGB, by angle in rad, with a logarithmic radius: angles, fit and optional reference [N], dots
// [[angle, value], ...] of samples; `at` is the angle of the direction that `seen` names.
function drawPolar(canvas, { angles, fit, reference, dots, at: marked, seen, title, axis }) {
  const ratio = devicePixelRatio, [width, height] = PLOT, g = canvas.getContext("2d"), base = [width / 2, height - 86], most = 118, floor = 1e-3;
  Object.assign(canvas, { width: width * ratio, height: height * ratio });
  Object.assign(canvas.style, { width: `${width}px`, height: `${height}px` });
  g.scale(ratio, ratio);
  const top = Math.max(...fit, ...(reference ?? []), 2 * floor);
  const radius = (value) => most * clamp(Math.log(Math.max(value, floor) / floor) / Math.log(top / floor), 0, 1);
  const place = (angle, r) => [base[0] + r * Math.sin(angle), base[1] - r * Math.cos(angle)], at = (angle, value) => place(angle, radius(value));
  Object.assign(g, { lineWidth: 1, strokeStyle: "#4a4d55", fillStyle: "#b4b8c0", font: "10px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
  const stroke = (points) => { g.beginPath(); points.forEach((point) => g.lineTo(...point)); g.stroke(); };
  for (let decade = Math.ceil(Math.log10(floor)); 10 ** decade <= top; decade++) {
    const r = radius(10 ** decade);
    g.beginPath(); g.arc(...base, r, Math.PI, 2 * Math.PI); g.stroke();
    if (r - radius(10 ** (decade - 1)) > 20) g.fillText(`${10 ** decade}`, base[0] + r, base[1] + 8);
  }
  for (const degree of [-90, -60, -30, 0, 30, 60, 90]) {
    stroke([base, place(degree * Math.PI / 180, most)]);
    g.fillText(`${Math.abs(degree)}\u00b0`, ...place(degree * Math.PI / 180, most + 11));
  }
  g.setLineDash([3, 3]);
  g.strokeStyle = LINES.seen;
  stroke([base, place(marked, most)]);
  const line = (values, colour, dash) => {
    Object.assign(g, { strokeStyle: colour, lineWidth: 1.6 });
    g.setLineDash(dash);
    stroke(angles.map((angle, i) => at(angle, values[i])));
  };
  if (reference) line(reference, LINES.reference, []);
  line(fit, LINES.fit, reference ? [5, 3] : []);
  g.setLineDash([]);
  g.fillStyle = LINES.reference;
  for (const [angle, value] of dots) g.fillRect(...at(angle, value).map((x) => x - 1), 2, 2);
  const entries = [["fit", LINES.fit, reference ? [4, 2] : []], ...(reference ? [["reference", LINES.reference, []]] : []), ...(dots.length ? [["samples", LINES.reference, null]] : []), [seen, LINES.seen, [3, 3]]];
  let x = 12;
  g.textAlign = "left";
  for (const [name, colour, dash] of entries) {
    Object.assign(g, { strokeStyle: colour, fillStyle: colour });
    if (dash) { g.setLineDash(dash); stroke([[x, height - 57], [x + 16, height - 57]]); g.setLineDash([]); } else for (const k of [2, 7, 12]) g.fillRect(x + k, height - 58, 2, 2);
    g.fillStyle = "#d5d8dd";
    g.fillText(name, x + 20, height - 57);
    x += 30 + g.measureText(name).width;
  }
  g.fillText(`f in 1/sr, mean of R, G, B; radius logarithmic from ${floor}`, 12, height - 41, width - 20);
  g.fillText(title, 12, height - 26, width - 20);
  g.fillText(`Angles: ${axis}`, 12, height - 11, width - 20);
  canvas.setAttribute("aria-label", `Polar plot of f in 1/sr: ${entries.map(([name]) => name).join(", ")}. ${title}; ${axis}`);
}

// Return the plane of incidence of a viewer at theta and an azimuth: pairs of directions, angles of the light, and the angles
// that samples lie at. Samples without phi_h lie at any azimuth.
function lobeOf(theta, azimuth) {
  const angles = Array.from({ length: 179 }, (_, i) => (i - 89) * Math.PI / 180);
  const along = (angle) => turnedBy(azimuth, [Math.sin(angle), 0, Math.cos(angle)]), wo = along(theta);
  const near = (h, d, phi, phiH) => {
    if (Math.abs(Math.sin(phi)) * Math.sin(d) > 0.05 || Math.abs(Math.sin((phiH ?? azimuth) - azimuth)) > 0.15) return [];  // the sample's half vector or difference vector lies outside of the plane
    const side = Math.sign(Math.cos(phi)) || 1, [wi, other] = [h + side * d, h - side * d];
    const signs = phiH === undefined ? [1, -1] : [Math.sign(Math.cos(phiH - azimuth))];
    return signs.flatMap((sign) => [[sign * wi, sign * other], [sign * other, sign * wi]])
      .filter(([a, b]) => Math.abs(b - theta) < 0.035 && Math.abs(a) < Math.PI / 2).map(([a]) => a);
  };
  return { angles, pairs: angles.map((a) => [along(a), wo]), near };
}

// Return the slice at theta_h and phi_h, by theta_d: to the right for phi_d of 90 degrees, to the left for phi_d of 0.
function sliceOf(thetaH, azimuth) {
  const pair = (d, phi) => [1, -1].map((sign) => {
    const [x, y, z] = [sign * Math.sin(d) * Math.cos(phi), sign * Math.sin(d) * Math.sin(phi), Math.cos(d)];
    return turnedBy(azimuth, [x * Math.cos(thetaH) + z * Math.sin(thetaH), y, z * Math.cos(thetaH) - x * Math.sin(thetaH)]);
  });
  const degree = Math.PI / 180, angles = [], pairs = [];
  for (let a = -89; a < 90; a++) {
    const both = a < 0 ? pair(-a * degree, 0) : pair(a * degree, Math.PI / 2);
    if (both[0][2] <= 0.01 || both[1][2] <= 0.01) continue;
    angles.push(a * degree); pairs.push(both);
  }
  const near = (h, d, phi, phiH) => {
    if (Math.abs(h - thetaH) > 0.035 || Math.cos((phiH ?? azimuth) - azimuth) < 0.99) return [];
    return Math.abs(Math.cos(phi)) < 0.12 ? [d] : Math.abs(Math.sin(phi)) < 0.12 ? [-d] : [];
  };
  return { angles, pairs, near };
}
