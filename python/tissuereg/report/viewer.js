"use strict";
// A body to turn, in every element of the class "viewer": triangles with a depth buffer on a 2-D canvas, signs above.
// The element holds a script of JSON, the scene, as report/viewer.py writes it. All text of a scene is set as text.
(function () {
  const SHADES = 64, STOPS = 256;
  const RAMP = ["#f3f4ee", "#c7e9b4", "#7fcdbb", "#41b6c4", "#1d91c0", "#225ea8", "#0c2c84"];
  const PATCHES = ["#c3cad3", "#7d858e", "#d6aa3c", "#78aa5a", "#9678be", "#5aaab4", "#c9826b", "#a8a05a"];
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
  const norm = (v) => Math.hypot(v[0], v[1], v[2]);

  // ---- numbers --------------------------------------------------------------------------------------------------
  function numbers(given) {
    const bytes = Uint8Array.from(atob(given.data), (c) => c.charCodeAt(0)).buffer;
    const kind = { i2: Int16Array, f4: Float32Array, u2: Uint16Array, u4: Uint32Array }[given.as];
    const raw = new kind(bytes);
    let out = raw;
    if (given.as === "i2") out = Float32Array.from(raw, (x) => (x === -32768 ? NaN : x * given.by));
    out.rows = given.shape[0];
    out.row = given.shape.slice(1).reduce((a, b) => a * b, 1);
    return out;
  }
  // Numbers by state, by case and by frame: of what does not change the last ones there are.
  function moving(given) {
    if (!given) return null;
    const all = given.map((cases) => cases.map(numbers));
    return (now) => {
      const cases = all[Math.min(now.state, all.length - 1)], one = cases[Math.min(now.case, cases.length - 1)];
      const first = Math.min(now.frame, one.rows - 1) * one.row;
      return one.subarray(first, first + one.row);
    };
  }
  const at = (list, i) => [list[3 * i], list[3 * i + 1], list[3 * i + 2]];
  const known = (v) => Number.isFinite(v[0] + v[1] + v[2]);
  function roundLength(most) {
    const power = Math.pow(10, Math.floor(Math.log10(most)));
    return power * [5, 2, 1].find((m) => m * power <= most);
  }

  function make(tag, into, said, set) {
    const one = document.createElement(tag);
    if (said) one.textContent = said;
    Object.assign(one, set || {});
    into.appendChild(one);
    return one;
  }

  function mount(host) {
    const scene = JSON.parse(host.querySelector("script").textContent), body = scene.body;
    const rest = numbers(body.nodes), corners = numbers(body.triangles), patch = numbers(body.patch);
    const modes = body.modes ? numbers(body.modes) : null, weights = moving(body.weights);
    const n = rest.rows, m = corners.rows;
    const layers = scene.layers.map((one) => ({ ...one, places: moving(one.places), by: moving(one.by) }));
    const paints = scene.paints.map((one) => ({ ...one, values: one.values ? numbers(one.values) : null }));
    const now = { state: scene.start.state, case: scene.start.case, frame: scene.start.frame, paint: scene.start.paint };
    const view = { yaw: scene.start.yaw, pitch: scene.start.pitch, zoom: 1, shiftX: 0, shiftY: 0 };
    const look = { opacity: scene.start.opacity, grow: 1, outline: scene.outline, wires: false };

    // ---- the body -----------------------------------------------------------------------------------------------
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < 3 * n; i += 1) {
      low[i % 3] = Math.min(low[i % 3], rest[i]);
      high[i % 3] = Math.max(high[i % 3], rest[i]);
    }
    const middle = low.map((x, k) => (x + high[k]) / 2), extent = norm(low.map((x, k) => high[k] - x));
    let reach = 0;
    for (let i = 0; i < n; i += 1) reach = Math.max(reach, norm(at(rest, i).map((x, k) => x - middle[k])));
    // Half the width and height of the body as it is seen first.
    const half = [0, 0], first = { cy: Math.cos(view.yaw), sy: Math.sin(view.yaw), cp: Math.cos(view.pitch), sp: Math.sin(view.pitch) };
    for (let i = 0; i < n; i += 1) {
      const [x, y, z] = at(rest, i).map((c, k) => c - middle[k]);
      half[0] = Math.max(half[0], Math.abs(first.cy * x + first.sy * y));
      half[1] = Math.max(half[1], Math.abs(first.cp * z + first.sp * (first.cy * y - first.sy * x)));
    }
    const places = new Float32Array(rest), faces = new Float32Array(3 * m), areas = new Float32Array(m);
    const normals = new Float32Array(9 * m), moved = new Float32Array(n); // normals at the corners of every triangle
    const around = Array.from({ length: n }, () => []);
    for (let i = 0; i < 3 * m; i += 1) around[corners[i]].push(Math.floor(i / 3));
    let shaped = "";
    function shape() {
      const key = modes ? Array.from(weights(now)).join() : "rest";
      if (key === shaped) return;
      shaped = key;
      places.set(rest);
      if (modes) weights(now).forEach((w, k) => {
        if (w) for (let i = 0; i < 3 * n; i += 1) places[i] += w * modes[k * 3 * n + i];
      });
      for (let t = 0; t < m; t += 1) {
        const a = 3 * corners[3 * t], b = 3 * corners[3 * t + 1], c = 3 * corners[3 * t + 2];
        const ux = places[b] - places[a], uy = places[b + 1] - places[a + 1], uz = places[b + 2] - places[a + 2];
        const vx = places[c] - places[a], vy = places[c + 1] - places[a + 1], vz = places[c + 2] - places[a + 2];
        const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx, size = Math.hypot(x, y, z) || 1;
        areas[t] = size;
        faces[3 * t] = x / size;
        faces[3 * t + 1] = y / size;
        faces[3 * t + 2] = z / size;
      }
      // Triangles that meet at a corner are smooth there, unless the body has an edge between them.
      for (let t = 0; t < m; t += 1) for (let k = 0; k < 3; k += 1) {
        let x = 0, y = 0, z = 0;
        for (const o of around[corners[3 * t + k]]) {
          const along = faces[3 * t] * faces[3 * o] + faces[3 * t + 1] * faces[3 * o + 1] + faces[3 * t + 2] * faces[3 * o + 2];
          if (along < 0.7) continue;
          x += areas[o] * faces[3 * o];
          y += areas[o] * faces[3 * o + 1];
          z += areas[o] * faces[3 * o + 2];
        }
        const size = Math.hypot(x, y, z) || 1;
        normals[9 * t + 3 * k] = x / size;
        normals[9 * t + 3 * k + 1] = y / size;
        normals[9 * t + 3 * k + 2] = z / size;
      }
      for (let i = 0; i < n; i += 1) moved[i] = norm([0, 1, 2].map((k) => places[3 * i + k] - rest[3 * i + k]));
    }
    let pairs = null; // edges with the triangles on both sides
    function edges() {
      if (pairs) return pairs;
      const seen = new Map();
      pairs = [];
      for (let t = 0; t < m; t += 1) for (let k = 0; k < 3; k += 1) {
        const a = corners[3 * t + k], b = corners[3 * t + ((k + 1) % 3)], key = Math.min(a, b) * n + Math.max(a, b);
        if (seen.has(key)) pairs[seen.get(key)][3] = t;
        else { seen.set(key, pairs.length); pairs.push([a, b, t, -1]); }
      }
      return pairs;
    }
    const restFaces = () => {
      if (!restFaces.kept) {
        restFaces.kept = new Float32Array(3 * m);
        for (let t = 0; t < m; t += 1) {
          const [a, b, c] = [0, 1, 2].map((k) => at(rest, corners[3 * t + k]));
          const u = b.map((x, k) => x - a[k]), v = c.map((x, k) => x - a[k]);
          restFaces.kept.set([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]], 3 * t);
        }
      }
      return restFaces.kept;
    };

    // ---- colours: one table of shades for the ramp, one for the patches --------------------------------------------
    const shaded = (colours) => {
      const table = new Uint32Array(colours.length * SHADES);
      colours.forEach((colour, i) => {
        for (let s = 0; s < SHADES; s += 1) {
          const light = 0.5 + 0.56 * (s / (SHADES - 1));
          const [r, g, b] = colour.map((x) => Math.min(255, Math.round(x * light)));
          table[i * SHADES + s] = (255 << 24) | (b << 16) | (g << 8) | r;
        }
      });
      return table;
    };
    const stops = RAMP.map(rgb);
    const ramp = Array.from({ length: STOPS }, (_, i) => {
      const x = (i / (STOPS - 1)) * (stops.length - 1), k = Math.min(Math.floor(x), stops.length - 2);
      return stops[k].map((c, j) => c + (x - k) * (stops[k + 1][j] - c));
    });
    const patchColour = (i) => rgb(scene.patches[i] ? scene.patches[i].colour : PATCHES[i % PATCHES.length]);
    const rampTable = shaded(ramp);
    const patchTable = shaded(Array.from({ length: Math.max(1, scene.patches.length) }, (_, i) => patchColour(i)));

    // ---- the camera -------------------------------------------------------------------------------------------------
    let dpr = 1, width = 1, height = 1, camera = null;
    function aim() {
      const cy = Math.cos(view.yaw), sy = Math.sin(view.yaw), cp = Math.cos(view.pitch), sp = Math.sin(view.pitch);
      const right = [cy, sy, 0], towards = [sy * cp, -cy * cp, sp], up = [-sy * sp, cy * sp, cp];
      const scale = Math.min((0.42 * width) / half[0], (0.38 * height) / half[1], (0.62 * Math.min(width, height)) / reach) * view.zoom;
      camera = { right, up, towards, scale, x: width / 2 + view.shiftX, y: height / 2 + view.shiftY };
    }
    function seen(p) {
      const x = p[0] - middle[0], y = p[1] - middle[1], z = p[2] - middle[2], { right, up, towards } = camera;
      return [
        camera.x + camera.scale * (right[0] * x + right[1] * y),
        camera.y - camera.scale * (up[0] * x + up[1] * y + up[2] * z),
        towards[0] * x + towards[1] * y + towards[2] * z,
      ];
    }

    // Whether the body has the colours of its patches now.
    const plain = () => !paints.length || !(paints[now.paint].values || paints[now.paint].moved);

    // ---- triangles into pixels ---------------------------------------------------------------------------------------
    const buffer = document.createElement("canvas");
    let pixels = null, image = null, depth = null, drawnTriangles = 0;
    const screen = new Float32Array(3 * n), shade = new Float32Array(n);
    function raster(quality, front) {
      const w = Math.max(1, Math.round(width * quality)), h = Math.max(1, Math.round(height * quality));
      if (buffer.width !== w || buffer.height !== h || !pixels) {
        buffer.width = w;
        buffer.height = h;
        image = buffer.getContext("2d").createImageData(w, h);
        pixels = new Uint32Array(image.data.buffer);
        depth = new Float32Array(w * h);
      }
      pixels.fill(0);
      depth.fill(-Infinity);
      const paint = paints[now.paint], flat = plain(), table = flat ? patchTable : rampTable;
      const values = flat ? null : paint.values || moved, top = flat ? 1 : Math.max(paint.top, 1e-12);
      const sun = [0, 1, 2].map((k) => 0.25 * camera.right[k] + 0.4 * camera.up[k] + 0.88 * camera.towards[k]);
      for (let i = 0; i < n; i += 1) {
        const p = seen(at(places, i));
        screen[3 * i] = p[0] * quality;
        screen[3 * i + 1] = p[1] * quality;
        screen[3 * i + 2] = p[2];
        if (!flat) shade[i] = Math.min(0.9999, Math.max(0, values[i] / top)) * STOPS;
      }
      for (let t = 0; t < m; t += 1) {
        const a = corners[3 * t], b = corners[3 * t + 1], c = corners[3 * t + 2];
        const ax = screen[3 * a], ay = screen[3 * a + 1], bx = screen[3 * b], by = screen[3 * b + 1];
        const cx = screen[3 * c], cy = screen[3 * c + 1];
        const area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
        if (area === 0 || area < 0 !== front) continue;
        drawnTriangles += 1;
        const side = front ? SHADES - 1 : 1 - SHADES, o9 = 9 * t;
        const light = (k) => Math.max(0, side * (normals[o9 + k] * sun[0] + normals[o9 + k + 1] * sun[1] + normals[o9 + k + 2] * sun[2]));
        const la = light(0), lb = light(3), lc = light(6), base = flat ? patch[t] * SHADES : 0;
        const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5)), right = Math.min(w - 1, Math.floor(Math.max(ax, bx, cx) + 0.5));
        const first = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5)), last = Math.min(h - 1, Math.floor(Math.max(ay, by, cy) + 0.5));
        const za = screen[3 * a + 2], zb = screen[3 * b + 2], zc = screen[3 * c + 2];
        const stepB = (cy - ay) / area, stepC = -(by - ay) / area, sa = shade[a], sb = shade[b], sc = shade[c];
        for (let y = first; y <= last; y += 1) {
          let wb = ((left - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area;
          let wc = ((y - ay) * (bx - ax) - (left - ax) * (by - ay)) / area;
          for (let x = left, o = y * w + left; x <= right; x += 1, o += 1, wb += stepB, wc += stepC) {
            const wa = 1 - wb - wc;
            if (wa < -1e-4 || wb < -1e-4 || wc < -1e-4) continue;
            const z = wa * za + wb * zb + wc * zc;
            if (z <= depth[o]) continue;
            depth[o] = z;
            const s = Math.min(SHADES - 1, wa * la + wb * lb + wc * lc) | 0;
            pixels[o] = table[(flat ? base : ((wa * sa + wb * sb + wc * sc) | 0) * SHADES) + (s < 0 ? 0 : s)];
          }
        }
      }
      buffer.getContext("2d").putImageData(image, 0, 0);
      return quality;
    }
    // Whether a place is behind the part of the surface that faces the viewer.
    function hidden(p) {
      const q = buffer.width / width, x = Math.round(p[0] * q), y = Math.round(p[1] * q);
      if (x < 0 || y < 0 || x >= buffer.width || y >= buffer.height) return false;
      return depth[y * buffer.width + x] > p[2] + 0.012 * extent;
    }

    // ---- signs --------------------------------------------------------------------------------------------------------
    let pen = null, boxes = [], words = [], tips = [];
    const colourOf = (layer) => (Array.isArray(layer.colour) ? layer.colour[Math.min(now.state, layer.colour.length - 1)] : layer.colour);
    const SIGNS = {
      dot(x, y, r) { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.fill(); },
      ring(x, y, r) { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.stroke(); },
      cross(x, y, r) { pen.beginPath(); pen.moveTo(x - r, y - r); pen.lineTo(x + r, y + r); pen.moveTo(x - r, y + r); pen.lineTo(x + r, y - r); pen.stroke(); },
      plus(x, y, r) { pen.beginPath(); pen.moveTo(x - r, y); pen.lineTo(x + r, y); pen.moveTo(x, y - r); pen.lineTo(x, y + r); pen.stroke(); },
      square(x, y, r) { pen.fillRect(x - r, y - r, 2 * r, 2 * r); },
    };
    function arrow(from, to, size) {
      const a = seen(from), b = seen(to), length = Math.hypot(b[0] - a[0], b[1] - a[1]);
      const head = Math.min(size, 0.5 * length), angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
      pen.beginPath();
      pen.moveTo(a[0], a[1]);
      pen.lineTo(b[0], b[1]);
      for (const side of [0.5, -0.5]) {
        pen.moveTo(b[0], b[1]);
        pen.lineTo(b[0] - head * Math.cos(angle + side), b[1] - head * Math.sin(angle + side));
      }
      pen.stroke();
    }
    function ellipsoid(centre, axes) {
      const ring = (f) => {
        pen.beginPath();
        for (let i = 0; i <= 40; i += 1) {
          const x = f((2 * Math.PI * i) / 40);
          const p = seen(centre.map((c, k) => c + axes[k] * x[0] + axes[3 + k] * x[1] + axes[6 + k] * x[2]));
          if (i) pen.lineTo(p[0], p[1]);
          else pen.moveTo(p[0], p[1]);
        }
        pen.stroke();
      };
      // The outline, filled: the ellipse of all places that the ellipsoid covers.
      const along = [0, 1, 2].map((j) => [camera.right, camera.up].map((v) => camera.scale * v.reduce((s, x, k) => s + x * axes[3 * j + k], 0)));
      const xx = along.reduce((s, v) => s + v[0] * v[0], 0), yy = along.reduce((s, v) => s + v[1] * v[1], 0);
      const xy = along.reduce((s, v) => s + v[0] * v[1], 0), half = Math.hypot((xx - yy) / 2, xy), p = seen(centre);
      const faint = pen.globalAlpha;
      pen.beginPath();
      pen.ellipse(p[0], p[1], Math.sqrt((xx + yy) / 2 + half), Math.sqrt(Math.max(0, (xx + yy) / 2 - half)), -0.5 * Math.atan2(2 * xy, xx - yy), 0, 7);
      pen.globalAlpha = 0.22 * faint;
      pen.fill();
      pen.globalAlpha = faint;
      pen.stroke();
      pen.globalAlpha = 0.5 * faint;
      ring((a) => [Math.cos(a), Math.sin(a), 0]);
      ring((a) => [Math.cos(a), 0, Math.sin(a)]);
      ring((a) => [0, Math.cos(a), Math.sin(a)]);
      pen.globalAlpha = faint;
    }
    function longest(layer) {
      if (layer.longest === undefined) {
        layer.longest = 0;
        for (const cases of scene.layers[layers.indexOf(layer)].by) for (const one of cases) {
          const flat = numbers(one);
          for (let i = 0; i < flat.length; i += 3) layer.longest = Math.max(layer.longest, norm(at(flat, i / 3)) || 0);
        }
      }
      return layer.longest;
    }
    // Arrows that grow: the longest of all frames is a share of the body at the slider's 1.
    const unit = (layer) => (layer.grow ? (layer.grow * extent) / Math.max(longest(layer), 1e-9) : 1);
    function sign(layer) {
      const list = layer.places(now), by = layer.by ? layer.by(now) : null, count = list.length / 3, colour = colourOf(layer);
      const factor = unit(layer) * (layer.grow ? look.grow : 1);
      let drawn = 0;
      pen.lineWidth = layer.width || 1.6;
      pen.setLineDash(layer.dashed ? [5, 3] : []);
      for (let i = 0; i < count; i += 1) {
        const place = at(list, i);
        if (!known(place)) continue;
        const p = seen(place), behind = hidden(p);
        pen.globalAlpha = behind ? layer.behind : 1;
        pen.strokeStyle = pen.fillStyle = colour;
        if (layer.kind === "points") SIGNS[layer.shape](p[0], p[1], layer.size);
        else if (layer.kind === "ellipsoids") ellipsoid(place, by.subarray(9 * i, 9 * i + 9));
        else {
          const to = at(by, i);
          if (!known(to)) continue;
          if (layer.kind === "arrows") arrow(place, place.map((x, k) => x + factor * to[k]), 9);
          else { const q = seen(to); pen.beginPath(); pen.moveTo(p[0], p[1]); pen.lineTo(q[0], q[1]); pen.stroke(); }
        }
        drawn += 1;
        if (layer.names.length) {
          tips.push([p, layer, i, behind]);
          if (layer.labels) words.push([p, layer.names[i], colour]);
        }
      }
      pen.globalAlpha = 1;
      pen.setLineDash([]);
      return drawn;
    }
    const meets = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
    function label(p, said, colour) {
      const wide = pen.measureText(said).width + 6, tall = 16;
      for (const reach of [9, 18, 30, 46, 64]) for (const [dx, dy] of [[1, -0.6], [1, 0.9], [-1, -0.6], [-1, 0.9], [0, -1.3], [0, 1.5]]) {
        const x = p[0] + dx * reach - (dx < 0 ? wide : dx ? 0 : wide / 2), y = p[1] + dy * reach - tall / 2;
        const box = [x, y, x + wide, y + tall];
        if (x < 2 || y < 2 || box[2] > width - 2 || box[3] > height - 2 || boxes.some((other) => meets(box, other))) continue;
        boxes.push(box);
        if (reach > 12) {
          pen.strokeStyle = colour;
          pen.lineWidth = 0.8;
          pen.beginPath();
          pen.moveTo(p[0], p[1]);
          pen.lineTo(Math.min(Math.max(p[0], x), x + wide), Math.min(Math.max(p[1], y), y + tall));
          pen.stroke();
        }
        pen.fillStyle = "rgba(255,255,255,0.82)";
        pen.fillRect(x, y, wide, tall);
        pen.fillStyle = colour;
        pen.fillText(said, x + 3, y + 12);
        return 1;
      }
      return 0;
    }
    function outline() {
      const facing = restFaces(), t = camera.towards, front = (k) => k >= 0 && facing[3 * k] * t[0] + facing[3 * k + 1] * t[1] + facing[3 * k + 2] * t[2] > 0;
      pen.strokeStyle = "rgba(60,66,74,0.75)";
      pen.lineWidth = 1.1;
      pen.setLineDash([4, 3]);
      pen.beginPath();
      for (const [a, b, one, other] of edges()) if (front(one) !== front(other)) {
        const p = seen(at(rest, a)), q = seen(at(rest, b));
        pen.moveTo(p[0], p[1]);
        pen.lineTo(q[0], q[1]);
      }
      pen.stroke();
      pen.setLineDash([]);
    }
    function wires() {
      const t = camera.towards, front = (k) => k >= 0 && faces[3 * k] * t[0] + faces[3 * k + 1] * t[1] + faces[3 * k + 2] * t[2] > 0;
      pen.strokeStyle = "rgba(40,46,54,0.28)";
      pen.lineWidth = 0.5;
      pen.beginPath();
      for (const [a, b, one, other] of edges()) if (front(one) || front(other)) {
        const p = seen(at(places, a)), q = seen(at(places, b));
        pen.moveTo(p[0], p[1]);
        pen.lineTo(q[0], q[1]);
      }
      pen.stroke();
    }
    function cross() {
      const x = 34, y = height - 34;
      boxes.push([0, height - 70, 72, height]);
      scene.axes.forEach((name, k) => {
        const dx = 22 * camera.right[k], dy = -22 * camera.up[k];
        pen.strokeStyle = pen.fillStyle = ["#a01c10", "#176f2c", "#1f4fa8"][k];
        pen.lineWidth = 1.5;
        pen.beginPath();
        pen.moveTo(x, y);
        pen.lineTo(x + dx, y + dy);
        pen.stroke();
        pen.textAlign = "center";
        pen.fillText(name, x + 1.35 * dx, y + 1.35 * dy + 4);
        pen.textAlign = "left";
      });
    }
    function bars() {
      const length = roundLength((0.28 * Math.min(width, 500)) / camera.scale), wide = length * camera.scale;
      const x = width - wide - 14, y = height - 14;
      pen.fillStyle = pen.strokeStyle = "#3a424b";
      pen.lineWidth = 2.5;
      pen.beginPath();
      pen.moveTo(x, y);
      pen.lineTo(x + wide, y);
      pen.stroke();
      pen.textAlign = "center";
      pen.fillText(Number(length.toPrecision(2)) + " mm", x + wide / 2, y - 6);
      pen.textAlign = "left";
      boxes.push([x - 6, y - 22, width, height]);
      const paint = paints[now.paint];
      if (plain()) return;
      const w = Math.min(150, 0.4 * width), left = 12, line = 26;
      const fill = pen.createLinearGradient(left, 0, left + w, 0);
      ramp.forEach((c, i) => { if (i % 15 === 0) fill.addColorStop(i / (STOPS - 1), "rgb(" + c.map(Math.round).join() + ")"); });
      pen.fillStyle = fill;
      pen.fillRect(left, line, w, 9);
      pen.fillStyle = "#3a424b";
      pen.fillText(paint.title + (paint.unit ? ", " + paint.unit : ""), left, line - 8);
      pen.fillText("0", left, line + 22);
      pen.textAlign = "right";
      pen.fillText((paint.over ? "\u2265 " : "") + Number(paint.top.toPrecision(3)), left + w, line + 22);
      pen.textAlign = "left";
      boxes.push([0, 0, Math.max(left + w, left + pen.measureText(paint.title + ", mm").width) + 6, line + 28]);
    }

    // ---- one picture ----------------------------------------------------------------------------------------------------
    const stage = make("div", host, "", { className: "stage" }), canvas = make("canvas", stage, "", { tabIndex: 0 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", scene.title + ": drag or use the arrow keys to turn");
    const tip = make("div", stage, "", { className: "tip" });
    let turning = false, asked = false;
    function draw() {
      asked = false;
      dpr = window.devicePixelRatio || 1;
      width = canvas.clientWidth;
      height = canvas.clientHeight;
      if (!width || !height) return;
      const w = Math.round(width * dpr), h = Math.round(height * dpr);
      if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
      pen = canvas.getContext("2d");
      pen.setTransform(dpr, 0, 0, dpr, 0, 0);
      pen.clearRect(0, 0, width, height);
      pen.font = "12px system-ui, sans-serif";
      pen.lineJoin = pen.lineCap = "round";
      aim();
      shape();
      boxes = [];
      words = [];
      tips = [];
      drawnTriangles = 0;
      const quality = turning ? Math.min(1, dpr) : Math.min(2, 1900 / width);
      pen.imageSmoothingQuality = "high";
      if (look.opacity < 0.99) {
        raster(quality, false);
        pen.globalAlpha = 0.5 * look.opacity;
        pen.drawImage(buffer, 0, 0, width, height);
      }
      raster(quality, true);
      pen.globalAlpha = look.opacity;
      pen.drawImage(buffer, 0, 0, width, height);
      pen.globalAlpha = 1;
      if (look.wires) wires();
      if (look.outline && modes) outline();
      const counts = {};
      for (const layer of layers) if (layer.shown && (!layer.states.length || layer.states.includes(now.state))) counts[layer.title] = sign(layer);
      cross();
      bars();
      let labelled = 0;
      for (const [p, said, colour] of words) labelled += label(p, said, colour);
      // What was drawn, for a reader that cannot see it.
      Object.assign(host.dataset, { triangles: drawnTriangles, signs: JSON.stringify(counts), labels: labelled, state: now.state, frame: now.frame, view: [view.yaw, view.pitch].map((x) => x.toFixed(2)).join(), depth: places.reduce((s, x) => s + Math.abs(x), 0).toFixed(1) });
      say();
    }
    function redraw() {
      if (asked) return;
      asked = true;
      window.requestAnimationFrame(draw);
    }
    function settle() {
      turning = false;
      redraw();
    }

    // ---- words ------------------------------------------------------------------------------------------------------------
    const figures = make("p", host, "", { className: "figures" });
    function vectors(layer, state) {
      const flat = layer.by({ ...now, state });
      return Array.from({ length: flat.length / 3 }, (_, i) => at(flat, i));
    }
    function say() {
      for (const key of keys) key.style.display = plain() && keys.length > 1 ? "" : "none";
      if (moment) moment.textContent = scene.cases[now.case].times[now.frame].toFixed(2) + " s";
      const said = [];
      if (scene.cases.length && scene.cases[now.case].said) said.push(scene.cases[now.case].said[now.frame]);
      for (const layer of layers.filter((one) => one.rms)) {
        const rms = scene.states.map((name, state) => {
          const sizes = vectors(layer, state).filter(known).map((v) => v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
          const mean = sizes.reduce((a, b) => a + b, 0) / (3 * sizes.length);
          return name + " " + (sizes.length ? Math.sqrt(mean).toFixed(3) + " " + layer.unit : "not seen");
        });
        said.push(layer.rms + ": " + rms.join(", ") + ".");
        said.push("At this setting 0.1 " + layer.unit + " is drawn " + (0.1 * unit(layer) * look.grow).toFixed(1) + " mm long.");
      }
      figures.textContent = said.join(" ");
    }
    function told(layer, i) {
      const lines = [layer.names[i]];
      if (layer.told.length) lines.push(layer.told[i]);
      if (layer.kind === "arrows" && layer.grow) scene.states.forEach((name, state) => {
        const v = vectors(layer, state)[i];
        lines.push(name + ": " + (known(v) ? norm(v).toFixed(3) + " " + layer.unit + " (" + v.map((c) => c.toFixed(3)).join(", ") + ")" : "not seen"));
      });
      return lines.join("\n");
    }
    function hover(x, y) {
      let best = null, near = 12;
      for (const one of tips) {
        const away = Math.hypot(one[0][0] - x, one[0][1] - y) + (one[3] ? 4 : 0);
        if (away < near) { near = away; best = one; }
      }
      const said = best ? told(best[1], best[2]) : surface(x, y);
      tip.style.display = said ? "block" : "none";
      if (!said) return;
      tip.textContent = said;
      tip.style.left = Math.max(4, Math.min(x + 14, width - tip.offsetWidth - 4)) + "px";
      tip.style.top = (y + 14 + tip.offsetHeight > height ? y - tip.offsetHeight - 8 : y + 14) + "px";
    }
    // The value of the surface's node under the pointer.
    function surface(x, y) {
      let best = -1, near = 10;
      for (let i = 0; i < n; i += 1) {
        const p = seen(at(places, i)), away = Math.hypot(p[0] - x, p[1] - y);
        if (away < near && !hidden(p)) { near = away; best = i; }
      }
      if (best < 0) return "";
      const lines = paints.filter((one) => one.values || one.moved).map((one) => one.title + " " + (one.values || moved)[best].toFixed(2) + " " + one.unit);
      if (scene.patches.length > 1) {
        const on = new Set();
        for (let t = 0; t < m; t += 1) for (let k = 0; k < 3; k += 1) if (corners[3 * t + k] === best) on.add(patch[t]);
        lines.push([...on].map((i) => scene.patches[i].name).join(", "));
      }
      return lines.concat("at (" + at(places, best).map((c) => c.toFixed(1)).join(", ") + ") mm").join("\n");
    }

    // ---- controls -----------------------------------------------------------------------------------------------------------
    const controls = document.createElement("div");
    controls.className = "controls";
    host.insertBefore(controls, stage);
    function field(title, into) {
      const one = make("label", into || controls);
      make("span", one, title);
      return one;
    }
    function slider(title, from, to, step, value, act) {
      const one = make("input", field(title), "", { type: "range", min: from, max: to, step, value });
      one.setAttribute("aria-label", title);
      one.addEventListener("input", () => { act(Number(one.value)); redraw(); });
      return one;
    }
    function choose(title, names, value, act) {
      const one = make("select", field(title));
      names.forEach((name, i) => make("option", one, name, { value: i }));
      one.value = value;
      one.addEventListener("change", () => { act(Number(one.value)); redraw(); });
      return one;
    }
    if (scene.states.length > 1) {
      const group = make("span", controls, "", { className: "switch" });
      scene.states.forEach((name, i) => {
        const one = make("button", group, name, { type: "button" });
        one.setAttribute("aria-pressed", i === now.state);
        one.addEventListener("click", () => {
          now.state = i;
          [...group.children].forEach((other, k) => other.setAttribute("aria-pressed", k === i));
          redraw();
        });
      });
    }
    let frames = null, moment = null;
    const last = () => scene.cases[now.case].times.length - 1;
    if (scene.cases.length > 1) choose("case", scene.cases.map((one) => one.name), now.case, (i) => {
      now.case = i;
      now.frame = Math.min(now.frame, last());
      frames.max = last();
      frames.value = now.frame;
    });
    if (scene.cases.length) {
      frames = slider(scene.clock || "frame", 0, last(), 1, now.frame, (i) => { now.frame = i; });
      frames.className = "frames";
      moment = make("output", frames.parentNode);
    }
    if (scene.clock) {
      let since = null;
      const play = make("button", controls, "play", { type: "button" });
      const step = (time) => {
        if (since === null) return;
        const times = scene.cases[now.case].times, gone = since[1] + (time - since[0]) / 1000;
        while (now.frame < last() && times[now.frame] < gone) now.frame += 1;
        frames.value = now.frame;
        draw();
        if (now.frame < last()) window.requestAnimationFrame(step);
        else stop();
      };
      const stop = () => { since = null; play.textContent = "play"; };
      play.addEventListener("click", () => {
        if (since !== null) { stop(); return; }
        if (now.frame === last()) now.frame = 0;
        since = [performance.now(), scene.cases[now.case].times[now.frame]];
        play.textContent = "stop";
        window.requestAnimationFrame(step);
      });
    }
    if (paints.length > 1) choose("colour", paints.map((one) => one.title), now.paint, (i) => { now.paint = i; });
    slider("opacity", 0.1, 1, 0.05, look.opacity, (x) => { look.opacity = x; });
    if (layers.some((one) => one.grow)) slider("arrows", 0.1, 4, 0.05, 1, (x) => { look.grow = x; });
    const views = make("span", controls, "", { className: "switch" });
    [["front", 0, 0], ["side", Math.PI / 2, 0], ["top", 0, Math.PI / 2], ["reset", scene.start.yaw, scene.start.pitch]].forEach(([name, yaw, pitch]) => {
      make("button", views, name, { type: "button" }).addEventListener("click", () => {
        Object.assign(view, { yaw, pitch, zoom: 1, shiftX: 0, shiftY: 0 });
        redraw();
      });
    });

    // ---- the legend, which shows and hides ------------------------------------------------------------------------------------
    const legend = document.createElement("div");
    legend.className = "legend";
    host.insertBefore(legend, figures);
    function entry(title, colour, shape, shown, act) {
      const one = make("label", legend), box = make("input", one, "", { type: "checkbox", checked: shown });
      const mark = make("canvas", one, "", { width: 36, height: 28, className: "mark" }), kept = pen;
      pen = mark.getContext("2d");
      pen.scale(2, 2);
      pen.strokeStyle = pen.fillStyle = colour;
      pen.lineWidth = 1.6;
      shape();
      pen = kept;
      make("span", one, title);
      box.addEventListener("change", () => { act(box.checked); redraw(); });
    }
    const marks = {
      points: (layer) => SIGNS[layer.shape](9, 7, Math.min(layer.size, 4.5)),
      arrows: () => { pen.beginPath(); pen.moveTo(2, 11); pen.lineTo(15, 3); pen.moveTo(9, 3); pen.lineTo(15, 3); pen.lineTo(13, 9); pen.stroke(); },
      lines: () => { pen.beginPath(); pen.moveTo(2, 7); pen.lineTo(16, 7); pen.stroke(); },
      ellipsoids: () => { pen.beginPath(); pen.ellipse(9, 7, 7, 4.5, 0, 0, 7); pen.stroke(); pen.globalAlpha = 0.25; pen.fill(); },
    };
    for (const layer of layers) entry(layer.title, Array.isArray(layer.colour) ? layer.colour[layer.colour.length - 1] : layer.colour, () => { if (layer.dashed) pen.setLineDash([3, 2]); marks[layer.kind](layer); }, layer.shown, (shown) => { layer.shown = shown; });
    if (modes) entry(scene.outline_title, "#3c424a", () => { pen.setLineDash([3, 2]); marks.lines(); }, look.outline, (shown) => { look.outline = shown; });
    entry("mesh lines", "#9aa2ab", marks.lines, false, (shown) => { look.wires = shown; });
    const used = new Set(patch);
    const keys = scene.patches.filter((_, i) => used.has(i)).map((one) => {
      const key = make("span", legend, "", { className: "patch" });
      make("i", key).style.background = one.colour;
      make("span", key, one.name);
      return key;
    });

    // ---- the pointer: one finger or the mouse turns, two fingers zoom, with shift it shifts ------------------------------------
    const held = new Map();
    const zoomed = (factor) => { view.zoom = Math.min(12, Math.max(0.3, view.zoom * factor)); };
    canvas.addEventListener("pointerdown", (event) => {
      held.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
      tip.style.display = "none";
    });
    canvas.addEventListener("pointermove", (event) => {
      const from = held.get(event.pointerId), box = canvas.getBoundingClientRect();
      if (!from) { if (camera) hover(event.clientX - box.left, event.clientY - box.top); return; }
      const others = [...held.entries()].filter(([id]) => id !== event.pointerId);
      if (others.length) {
        const fixed = others[0][1], was = Math.hypot(from[0] - fixed[0], from[1] - fixed[1]);
        zoomed(Math.hypot(event.clientX - fixed[0], event.clientY - fixed[1]) / Math.max(was, 1));
      } else if (event.shiftKey) {
        view.shiftX += event.clientX - from[0];
        view.shiftY += event.clientY - from[1];
      } else {
        view.yaw -= 0.01 * (event.clientX - from[0]);
        view.pitch = Math.min(1.57, Math.max(-1.57, view.pitch + 0.01 * (event.clientY - from[1])));
      }
      held.set(event.pointerId, [event.clientX, event.clientY]);
      turning = true;
      redraw();
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => { held.delete(event.pointerId); settle(); });
    canvas.addEventListener("pointerleave", () => { tip.style.display = "none"; });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls until the body is chosen
      event.preventDefault();
      zoomed(Math.exp(-0.0015 * event.deltaY));
      redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (turn) { view.yaw += turn[0]; view.pitch = Math.min(1.57, Math.max(-1.57, view.pitch + turn[1])); }
      else if (event.key === "+" || event.key === "-") zoomed(event.key === "+" ? 1.15 : 1 / 1.15);
      else return;
      event.preventDefault();
      redraw();
    });
    new ResizeObserver(redraw).observe(canvas);
    draw();
  }
  document.querySelectorAll(".viewer").forEach(mount);
})();
