"use strict";
// The turnable view: triangles sorted by depth and shaded flat on a 2-D canvas; residuals as arrows.
(function () {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.getElementById("view");
  const pick = (id) => document.getElementById(id);
  const mm = (list) => list.map((x) => (x === null ? NaN : x / 1000));
  const nodes = mm(scene.nodes), markers = mm(scene.markers.places);
  const palette = [[188, 196, 206], [120, 126, 134], [214, 170, 60], [120, 170, 90], [150, 120, 190], [90, 170, 180]];
  const colourOf = (patch) => palette[patch < 2 ? patch : 2 + ((patch - 2) % (palette.length - 2))];
  const state = { yaw: -0.9, pitch: 0.45, zoom: 1, shiftX: 0, shiftY: 0, case: scene.start[0], frame: scene.start[1], after: false };

  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < nodes.length; i += 1) {
    low[i % 3] = Math.min(low[i % 3], nodes[i]);
    high[i % 3] = Math.max(high[i % 3], nodes[i]);
  }
  const middle = low.map((x, k) => (x + high[k]) / 2);
  const extent = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
  const norm = (v) => Math.hypot(v[0], v[1], v[2]);

  // Largest residuals of all cases: an arrow of this length is a tenth of the body at slider 1.
  const largest = (key) => {
    let top = 0;
    for (const one of scene.cases) {
      const flat = one[key];
      for (let i = 0; i < flat.length; i += 3) {
        const size = norm([flat[i] || 0, flat[i + 1] || 0, flat[i + 2] || 0]);
        if (size > top) top = size;
      }
    }
    return top;
  };
  const unit = (0.16 * extent) / Math.max(largest("before") / 1000, 1e-9);
  const forceUnit = (0.16 * extent) / Math.max(largest("forces_before"), 1e-9);

  let turned;
  function turn() {
    const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), cp = Math.cos(state.pitch), sp = Math.sin(state.pitch);
    const scale = (1.05 * Math.min(canvas.width, 1.35 * canvas.height) * state.zoom) / extent;
    turned = (p) => {
      const x = p[0] - middle[0], y = p[1] - middle[1], z = p[2] - middle[2];
      const right = cy * x + sy * y, back = -sy * x + cy * y;
      return [
        canvas.width / 2 + state.shiftX + scale * right,
        canvas.height / 2 + state.shiftY - scale * (cp * z + sp * back),
        cp * back - sp * z,
      ];
    };
  }
  const at = (list, i) => [list[3 * i], list[3 * i + 1], list[3 * i + 2]];

  function residual(when, marker) {
    const one = scene.cases[state.case], flat = one[when], first = 3 * (state.frame * scene.markers.names.length + marker);
    return flat[first] === null || flat[first] === undefined ? null : [flat[first] / 1000, flat[first + 1] / 1000, flat[first + 2] / 1000];
  }
  function force(when, pad) {
    const one = scene.cases[state.case], i = one.pads.indexOf(scene.pads[pad].name);
    if (i < 0) return null;
    const flat = one["forces_" + when], first = 3 * (state.frame * one.pads.length + i);
    return flat[first] === null || flat[first] === undefined ? null : flat.slice(first, first + 3);
  }

  function body(pen, opacity, front, places) {
    const list = [];
    for (let t = 0; t < scene.patch.length; t += 1) {
      const a = places[scene.triangles[3 * t]], b = places[scene.triangles[3 * t + 1]], c = places[scene.triangles[3 * t + 2]];
      const facing = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0;
      if (facing === front) list.push([a[2] + b[2] + c[2], t, a, b, c]);
    }
    list.sort((one, other) => other[0] - one[0]);
    for (const [, t, a, b, c] of list) {
      const p = at(nodes, scene.triangles[3 * t]), q = at(nodes, scene.triangles[3 * t + 1]), r = at(nodes, scene.triangles[3 * t + 2]);
      const u = [q[0] - p[0], q[1] - p[1], q[2] - p[2]], v = [r[0] - p[0], r[1] - p[1], r[2] - p[2]];
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const lit = (0.3 * n[0] - 0.5 * n[1] + 0.81 * n[2]) / Math.max(norm(n), 1e-12);
      const light = 0.72 + 0.28 * lit;
      const [red, green, blue] = colourOf(scene.patch[t]).map((x) => Math.round(Math.min(255, x * light)));
      const fill = "rgba(" + red + "," + green + "," + blue + "," + opacity + ")";
      pen.fillStyle = fill;
      pen.strokeStyle = opacity > 0.95 ? fill : "rgba(70,80,90,0.10)";
      pen.lineWidth = 0.6;
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      pen.lineTo(c[0], c[1]);
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }

  function curve(pen, points) {
    pen.beginPath();
    points.forEach((p, i) => { const q = turned(p); if (i) pen.lineTo(q[0], q[1]); else pen.moveTo(q[0], q[1]); });
    pen.stroke();
  }
  function ellipsoid(pen, one) {
    const centre = mm(one.centre), axes = mm(one.axes), count = 48;
    pen.strokeStyle = one.found ? "rgba(176,20,60,0.85)" : "rgba(60,60,60,0.7)";
    pen.lineWidth = 1.2 * dpr;
    const ring = (f) => curve(pen, Array.from({ length: count + 1 }, (_, i) => {
      const p = f((2 * Math.PI * i) / count);
      return p.map((x, k) => centre[k] + axes[k] * x);
    }));
    for (let k = 0; k < 6; k += 1) {
      const turnBy = (Math.PI * k) / 6, c = Math.cos(turnBy), s = Math.sin(turnBy);
      ring((w) => [c * Math.cos(w), s * Math.cos(w), Math.sin(w)]);
    }
    for (let k = -2; k <= 2; k += 1) {
      const h = Math.sin((Math.PI * k) / 6), r = Math.cos((Math.PI * k) / 6);
      ring((w) => [r * Math.cos(w), r * Math.sin(w), h]);
    }
  }
  function arrow(pen, from, by, colour) {
    const a = turned(from), b = turned(from.map((x, k) => x + by[k]));
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]), head = Math.min(7 * dpr, 0.4 * length);
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
    pen.strokeStyle = colour;
    pen.lineWidth = 2 * dpr;
    pen.beginPath();
    pen.moveTo(a[0], a[1]);
    pen.lineTo(b[0], b[1]);
    for (const side of [0.5, -0.5]) {
      pen.moveTo(b[0], b[1]);
      pen.lineTo(b[0] - head * Math.cos(angle + side), b[1] - head * Math.sin(angle + side));
    }
    pen.stroke();
  }
  function dot(pen, place, size, colour, hollow) {
    const p = turned(place);
    pen.beginPath();
    pen.arc(p[0], p[1], size * dpr, 0, 2 * Math.PI);
    if (hollow) { pen.strokeStyle = colour; pen.lineWidth = 1.5 * dpr; pen.stroke(); }
    else { pen.fillStyle = colour; pen.fill(); }
  }
  function label(pen, place, text, colour) {
    const p = turned(place);
    pen.font = 12 * dpr + "px system-ui, sans-serif";
    pen.fillStyle = colour;
    pen.fillText(text, p[0] + 8 * dpr, p[1] - 6 * dpr);
  }
  function axesCross(pen) {
    const origin = turned(middle), corner = [40 * dpr, canvas.height - 40 * dpr];
    ["x", "y", "z"].forEach((name, k) => {
      const tip = turned(middle.map((x, i) => x + (i === k ? 0.05 * extent : 0)));
      const grow = (28 * dpr) / ((0.05 * 1.05 * Math.min(canvas.width, 1.35 * canvas.height)) * state.zoom);
      const x = corner[0] + grow * (tip[0] - origin[0]), y = corner[1] + grow * (tip[1] - origin[1]);
      pen.strokeStyle = pen.fillStyle = "#444";
      pen.lineWidth = 1.2 * dpr;
      pen.beginPath();
      pen.moveTo(corner[0], corner[1]);
      pen.lineTo(x, y);
      pen.stroke();
      pen.font = 11 * dpr + "px system-ui, sans-serif";
      pen.fillText(name, x + 3 * dpr, y);
    });
  }

  let dpr = 1;
  function draw() {
    dpr = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * dpr), height = Math.round(canvas.clientHeight * dpr);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const pen = canvas.getContext("2d"), opacity = Number(pick("opacity").value), grow = Number(pick("grow").value);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    turn();
    const places = [];
    for (let i = 0; i < nodes.length / 3; i += 1) places.push(turned(at(nodes, i)));
    body(pen, opacity, false, places);
    if (opacity < 0.95) scene.inclusions.forEach((one) => ellipsoid(pen, one));
    body(pen, opacity, true, places);
    if (opacity >= 0.95) scene.inclusions.forEach((one) => ellipsoid(pen, one));
    const when = state.after ? "after" : "before", colour = state.after ? "#1f5fa8" : "#c2571a";
    scene.targets.forEach((one) => { dot(pen, mm(one.place), 3.5, "#7a1fa8"); label(pen, mm(one.place), one.name, "#7a1fa8"); });
    scene.pads.forEach((pad, i) => {
      const points = mm(pad.nodes), shade = "rgb(" + colourOf(2 + i).map((x) => Math.round(0.7 * x)).join(",") + ")";
      for (let k = 0; k < points.length / 3; k += 1) dot(pen, at(points, k), 1.5, shade);
      label(pen, mm(pad.centre), pad.name, "#6b5310");
      const by = force(when, i);
      if (by) arrow(pen, mm(pad.centre), by.map((x) => x * forceUnit * grow), "#2d8a4e");
    });
    scene.markers.names.forEach((name, i) => {
      const place = at(markers, i), by = residual(when, i);
      dot(pen, place, 3, by ? "#20262e" : "#9aa2ab", !by);
      if (scene.named.includes(name)) { dot(pen, place, 8, "#b0143c", true); label(pen, place, name, "#b0143c"); }
      if (by) arrow(pen, place, by.map((x) => x * unit * grow), colour);
    });
    axesCross(pen);
    const one = scene.cases[state.case];
    pick("moment").textContent = one.times[state.frame].toFixed(2) + " s";
    const rms = (key) => {
      let sum = 0, count = 0;
      scene.markers.names.forEach((_, i) => { const v = residual(key, i); if (v) { sum += v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; count += 3; } });
      return count ? Math.sqrt(sum / count).toFixed(3) + " mm" : "not seen";
    };
    pick("figures").textContent = "Residual of a coordinate in this frame (rms): before " + rms("before") + ", after " + rms("after") +
      ". At this setting 0.1 mm is drawn " + (0.1 * unit * grow).toFixed(1) + " mm long.";
  }

  function hover(event) {
    const box = canvas.getBoundingClientRect(), tip = pick("tip");
    const x = (event.clientX - box.left) * dpr, y = (event.clientY - box.top) * dpr;
    let best = -1, near = 12 * dpr;
    scene.markers.names.forEach((_, i) => {
      const p = turned(at(markers, i)), away = Math.hypot(p[0] - x, p[1] - y);
      if (away < near) { near = away; best = i; }
    });
    tip.style.display = best < 0 ? "none" : "block";
    if (best < 0) return;
    const said = (when) => {
      const v = residual(when, best);
      return when + ": " + (v ? norm(v).toFixed(3) + " mm (" + v.map((c) => c.toFixed(3)).join(", ") + ")" : "not seen");
    };
    tip.textContent = scene.markers.names[best] + "\n" + said("before") + "\n" + said("after");
    tip.style.left = Math.min(event.clientX - box.left + 14, box.width - 210) + "px";
    tip.style.top = event.clientY - box.top + 14 + "px";
  }

  // One finger or the mouse turns, two fingers zoom, with shift it shifts.
  const held = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    held.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) { hover(event); return; }
    const others = [...held.entries()].filter(([id]) => id !== event.pointerId);
    if (others.length) {
      const fixed = others[0][1];
      const was = Math.hypot(last[0] - fixed[0], last[1] - fixed[1]), is = Math.hypot(event.clientX - fixed[0], event.clientY - fixed[1]);
      state.zoom = Math.min(8, Math.max(0.3, (state.zoom * is) / Math.max(was, 1)));
    } else if (event.shiftKey) {
      state.shiftX += (event.clientX - last[0]) * dpr;
      state.shiftY += (event.clientY - last[1]) * dpr;
    } else {
      state.yaw += 0.01 * (event.clientX - last[0]);
      state.pitch = Math.min(1.57, Math.max(-1.57, state.pitch + 0.01 * (event.clientY - last[1])));
    }
    held.set(event.pointerId, [event.clientX, event.clientY]);
    draw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => { pick("tip").style.display = "none"; });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    state.zoom = Math.min(8, Math.max(0.3, state.zoom * Math.exp(-0.0015 * event.deltaY)));
    draw();
  }, { passive: false });

  function choose() {
    const frames = pick("frame");
    frames.max = scene.cases[state.case].times.length - 1;
    state.frame = Math.min(state.frame, Number(frames.max));
    frames.value = state.frame;
    draw();
  }
  scene.cases.forEach((one, i) => {
    const option = document.createElement("option");
    option.textContent = one.name;
    option.value = i;
    pick("case").appendChild(option);
  });
  pick("case").value = state.case;
  pick("case").addEventListener("change", () => { state.case = Number(pick("case").value); choose(); });
  pick("frame").addEventListener("input", () => { state.frame = Number(pick("frame").value); draw(); });
  for (const id of ["grow", "opacity"]) pick(id).addEventListener("input", draw);
  for (const id of ["before", "after"]) pick(id).addEventListener("change", () => { state.after = pick("after").checked; draw(); });
  window.addEventListener("resize", draw);
  choose();
})();
