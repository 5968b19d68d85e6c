// Point cloud, camera paths and images on plain WebGL: orbit, pan, zoom, read a coordinate, measure a distance, colour
// by a scale, show the image of a camera. No libraries. The page scrolls over it until it is clicked (or focused).
(function () {
  "use strict";
  const holder = document.getElementById("viewer"), canvas = holder && holder.querySelector("canvas");
  if (!canvas) return;
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const chooser = holder.querySelector("select");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { holder.classList.add("off"); return; }
  holder.classList.add("on");

  const hex = (colour) => [1, 3, 5].map((k) => parseInt(colour.substr(k, 2), 16));
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const steps = new Uint16Array(bytes(data.xyz).buffer), colours = bytes(data.rgb);
  const n = data.count, low = data.low, half = [0, 1, 2].map((c) => {
    let top = 0;
    for (let k = c; k < 3 * n; k += 3) if (steps[k] > top) top = steps[k];
    return top * data.step / 2;
  });
  // positions relative to the middle of the box keep 32-bit floats exact enough
  const xyz = new Float32Array(3 * n);
  for (let k = 0; k < 3 * n; k++) xyz[k] = steps[k] * data.step - half[k % 3];
  const world = (p) => [0, 1, 2].map((c) => p[c] + low[c] + half[c] + data.offset[c]);
  const local = (p) => p.map((v, c) => v - low[c] - half[c]);
  const radius = Math.hypot(half[0], half[1], half[2]) || 1;

  const program = link(
    "attribute vec3 p; attribute vec3 c; uniform mat4 m; uniform float s; uniform float k; varying vec3 v;" +
    "void main() { gl_Position = m * vec4(p, 1.0); gl_PointSize = clamp(s * k / gl_Position.w, 1.0, 24.0); v = c; }",
    "precision mediump float; varying vec3 v; uniform float round;" +
    "void main() { vec2 d = gl_PointCoord - 0.5; if (round > 0.5 && dot(d, d) > 0.25) discard; gl_FragColor = vec4(v, 1.0); }");
  const at = (name) => gl.getUniformLocation(program, name);
  const uniform = { m: at("m"), s: at("s"), k: at("k"), round: at("round") };
  const cloud = { p: buffer(xyz), n: n };
  const looks = [{ name: data.text.colour, buffer: buffer(colours) }].concat(data.scales);
  const images = data.images.map((k) => ({ name: k.name, picture: k.picture, at: local(k.at) }));
  const paths = data.tracks.map((t) => {
    const p = new Float32Array(t.xyz.map((value, k) => value - low[k % 3] - half[k % 3]));
    const rgb = hex(t.colour);
    const c = new Uint8Array(p.length).map((_, k) => rgb[k % 3]);
    return { p: buffer(p), c: buffer(c), n: p.length / 3, line: t.line };
  });

  const middle = data.middle.map((v, c) => v - low[c] - half[c]);
  const start = { azimuth: -2.2, elevation: 0.6, distance: 2.4 * data.reach, target: middle };
  let view = copy(start), size = 1, look = 0, showPaths = true, marks = [], queued = false;

  function copy(v) { return { azimuth: v.azimuth, elevation: v.elevation, distance: v.distance, target: v.target.slice() }; }
  function axes() {
    const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth);
    const ce = Math.cos(view.elevation), se = Math.sin(view.elevation);
    return { right: [-sa, ca, 0], up: [-ca * se, -sa * se, ce], back: [ca * ce, sa * ce, se] };
  }
  const focal = 1.6; // 1 / tan(half the vertical field of view)
  function matrix() { // column-major projection * view
    const a = axes(), t = view.target, d = view.distance, near = d / 200, far = d + 4 * radius;
    const rows = [a.right, a.up, a.back], move = rows.map((r) => -(r[0] * t[0] + r[1] * t[1] + r[2] * t[2]));
    move[2] -= d;
    const aspect = canvas.width / canvas.height, q = (far + near) / (near - far), w = 2 * far * near / (near - far);
    const m = new Float32Array(16);
    for (let c = 0; c < 4; c++) {
      const column = rows.map((r, k) => (c < 3 ? r[c] : move[k]));
      m[4 * c] = focal / aspect * column[0];
      m[4 * c + 1] = focal * column[1];
      m[4 * c + 2] = q * column[2] + (c === 3 ? w : 0);
      m[4 * c + 3] = -column[2];
    }
    return m;
  }
  function draw() {
    queued = false;
    const ratio = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h);
    const field = (getComputedStyle(canvas).backgroundColor.match(/\d+/g) || [247, 247, 248]).map((v) => v / 255);
    gl.clearColor(field[0], field[1], field[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniform.m, false, matrix());
    const spacing = 2 * data.reach / Math.sqrt(n); // grows with the gaps between the points
    gl.uniform1f(uniform.k, h * focal * spacing);
    gl.uniform1f(uniform.round, 0);
    gl.uniform1f(uniform.s, size);
    set(cloud.p, looks[look].buffer || (looks[look].buffer = buffer(scaleColours(looks[look]))));
    gl.drawArrays(gl.POINTS, 0, cloud.n);
    if (showPaths) paths.forEach(drawPath);
    if (marks.length) drawMarks();
    scaleBar(h);
    northArrow();
  }
  function drawPath(t) {
    set(t.p, t.c);
    gl.uniform1f(uniform.round, 1);
    gl.uniform1f(uniform.k, 1);
    gl.uniform1f(uniform.s, 7 * view.distance * (window.devicePixelRatio || 1));
    gl.drawArrays(gl.POINTS, 0, t.n);
    gl.uniform1f(uniform.round, 0);
    if (t.line) gl.drawArrays(gl.LINE_STRIP, 0, t.n);
  }
  function drawMarks() {
    const p = buffer(new Float32Array(marks.flat())), c = buffer(new Uint8Array(marks.flatMap(() => [220, 30, 30])));
    gl.disable(gl.DEPTH_TEST);
    drawPath({ p: p, c: c, n: marks.length, line: true });
    gl.deleteBuffer(p);
    gl.deleteBuffer(c);
  }
  function redraw() { if (!queued) { queued = true; requestAnimationFrame(draw); } }
  function set(p, c) {
    attribute("p", p, gl.FLOAT, false);
    attribute("c", c, gl.UNSIGNED_BYTE, true);
  }
  function attribute(name, source, type, normalised) {
    const place = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, source);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, type, normalised, 0, 0);
  }
  function buffer(array) {
    const b = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, b);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    return b;
  }
  function link(vertex, fragment) {
    const p = gl.createProgram();
    [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].forEach(function (part) {
      const shader = gl.createShader(part[0]);
      gl.shaderSource(shader, part[1]);
      gl.compileShader(shader);
      gl.attachShader(p, shader);
    });
    gl.linkProgram(p);
    return p;
  }
  const viridis = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  function scaleColours(scale) {
    const values = bytes(scale.values), out = new Uint8Array(3 * n), stops = viridis;
    for (let k = 0; k < n; k++) {
      const u = values[k] / 254 * 4, i = Math.min(Math.floor(u), 3);
      for (let c = 0; c < 3; c++) out[3 * k + c] = values[k] === 255 ? 150 : stops[i][c] + (u - i) * (stops[i + 1][c] - stops[i][c]);
    }
    return out;
  }
  function legend() {
    const out = holder.querySelector(".legend"), scale = looks[look];
    if (!out) return;
    out.textContent = scale.name;
    if (scale.values !== undefined) {
      const bar = document.createElement("i"), digits = scale.high - scale.low < 1 ? 3 : 1;
      bar.style.background = "linear-gradient(to right," + viridis.map((k) => "rgb(" + k.join(",") + ")").join(",") + ")";
      out.append("  " + scale.low.toFixed(digits) + " ", bar, " " + scale.high.toFixed(digits) + " " + scale.unit);
    }
    if (scale.unknown) out.append("   ", swatch("#969696"), " " + data.text.unknown);
    if (chooser) chooser.selectedIndex = look;
    if (showPaths && data.tracks.length > 1) {
      out.append(document.createElement("br"), data.text.paths);
      data.tracks.forEach((k) => out.append("   ", swatch(k.colour), " " + k.name));
    }
  }
  function swatch(colour) {
    const out = document.createElement("i");
    out.className = "swatch";
    out.style.background = colour;
    return out;
  }
  function northArrow() {
    const out = holder.querySelector(".north");
    if (!out) return;
    const a = axes();
    out.hidden = !data.north;
    out.style.transform = "rotate(" + Math.atan2(a.right[1], a.up[1]) + "rad)";
  }

  // the point under the cursor: the nearest to the eye within a few pixels
  function near(m, p, box, x, y) { // pixels away from the cursor, and depth
    const w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
    const u = ((m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12]) / w + 1) / 2 * box.width - x;
    const v = (1 - (m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13]) / w) / 2 * box.height - y;
    return w > 0 ? Math.hypot(u, v) : Infinity;
  }
  function pickImage(event) {
    const box = canvas.getBoundingClientRect(), m = matrix(), x = event.clientX - box.left, y = event.clientY - box.top;
    let best = null, score = 8;
    images.forEach(function (k) {
      const away = showPaths ? near(m, k.at, box, x, y) - (k.picture ? 1 : 0) : Infinity; // of several at one place, one that can be shown
      if (away < score) { score = away; best = k; }
    });
    return best;
  }
  function showImage(k) {
    const out = holder.querySelector(".image");
    if (!out) return;
    out.replaceChildren();
    if (!k) return;
    if (k.picture) {
      const shown = document.createElement("img");
      shown.src = k.picture;
      shown.alt = k.name;
      out.append(shown);
    }
    out.append(k.name);
  }
  function pick(event) {
    const box = canvas.getBoundingClientRect(), m = matrix();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    let best = -1, score = Infinity;
    for (let k = 0; k < n; k++) {
      const px = xyz[3 * k], py = xyz[3 * k + 1], pz = xyz[3 * k + 2];
      const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
      if (w <= 0) continue;
      const u = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w + 1) / 2 * box.width - x;
      const v = (1 - (m[1] * px + m[5] * py + m[9] * pz + m[13]) / w) / 2 * box.height - y;
      const away = Math.hypot(u, v);
      if (away < 7 && w * (1 + 0.02 * away) < score) { score = w * (1 + 0.02 * away); best = k; }
    }
    return best < 0 ? null : [xyz[3 * best], xyz[3 * best + 1], xyz[3 * best + 2]];
  }
  function say() {
    const out = holder.querySelector(".readout");
    if (!marks.length) { out.textContent = data.text.hint; return; }
    const text = (p) => world(p).map((v, c) => data.axes[c] + " " + v.toFixed(2)).join("  ");
    out.textContent = marks.map(text).join("  \u2192  ") + " " + data.unit;
    if (marks.length === 2) {
      const d = [0, 1, 2].map((c) => marks[1][c] - marks[0][c]);
      out.textContent += ";  " + data.text.distance + " " + Math.hypot(d[0], d[1], d[2]).toFixed(3) + " " + data.unit +
        ", " + data.text.difference + " " + d[2].toFixed(3) + " " + data.unit;
    }
  }
  function scaleBar(h) {
    const perUnit = h * focal / 2 / view.distance / (window.devicePixelRatio || 1);
    const power = Math.pow(10, Math.floor(Math.log10(140 / perUnit)));
    const length = [5, 2, 1].map((k) => k * power).find((k) => k * perUnit <= 140);
    const bar = holder.querySelector(".bar");
    bar.style.width = length * perUnit + "px";
    bar.textContent = Number(length.toPrecision(2)) + " " + (length === 1 ? data.unit.replace(/s$/, "") : data.unit);
  }

  const held = new Map();
  let travelled = 0, pinch = 0;
  canvas.addEventListener("pointerdown", function (e) {
    if (e.pointerType === "mouse") canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(e.pointerId);
    held.set(e.pointerId, [e.clientX, e.clientY]);
    travelled = 0;
    pinch = 0;
  });
  canvas.addEventListener("pointermove", function (e) {
    const was = held.get(e.pointerId);
    if (!was) return;
    const dx = e.clientX - was[0], dy = e.clientY - was[1];
    held.set(e.pointerId, [e.clientX, e.clientY]);
    travelled += Math.abs(dx) + Math.abs(dy);
    if (held.size === 2) {
      const [a, b] = [...held.values()], gap = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (pinch) view.distance *= pinch / gap;
      pinch = gap;
      move(dx / 2, dy / 2);
    } else if (e.shiftKey || e.buttons & 6) {
      move(dx, dy);
    } else {
      view.azimuth -= 0.006 * dx;
      tilt(0.006 * dy);
    }
    redraw();
  });
  function release(e) {
    held.delete(e.pointerId);
    if (e.type !== "pointerup" || travelled > 4 || held.size) return;
    canvas.focus({ preventScroll: true });
    const image = pickImage(e), found = image ? null : pick(e);
    showImage(image);
    marks = found ? (marks.length === 1 ? [marks[0], found] : [found]) : [];
    say();
    redraw();
  }
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("dblclick", function (e) {
    const found = pick(e);
    if (found) { view.target = found; view.distance *= 0.6; redraw(); }
  });
  canvas.addEventListener("wheel", function (e) {
    if (document.activeElement !== canvas) return; // the page scrolls
    e.preventDefault();
    zoom(Math.exp(0.0012 * e.deltaY));
  }, { passive: false });
  canvas.addEventListener("focus", () => { canvas.style.touchAction = "none"; });
  canvas.addEventListener("blur", () => { canvas.style.touchAction = "pan-y"; });
  canvas.style.touchAction = "pan-y";
  function zoom(factor) {
    view.distance = Math.min(Math.max(view.distance * factor, radius / 2000), 12 * radius);
    redraw();
  }
  const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  canvas.addEventListener("keydown", function (e) {
    const turn = turns[e.key], act = { Home: "reset", t: "top", c: "colour", p: "paths" }[e.key];
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (turn && e.shiftKey) move(-40 * turn[0], -40 * turn[1]);
    else if (turn) { view.azimuth += 0.1 * turn[0]; tilt(-0.1 * turn[1]); }
    else if (e.key === "+" || e.key === "=") zoom(0.8);
    else if (e.key === "-") zoom(1.25);
    else if (e.key === "Escape") canvas.blur();
    else if (act) actions[act]();
    else return;
    e.preventDefault();
    redraw();
  });
  function tilt(by) { view.elevation = Math.min(Math.max(view.elevation + by, -1.5707), 1.5707); }
  function move(dx, dy) {
    const a = axes(), unit = 2 * view.distance / focal / canvas.clientHeight;
    for (let c = 0; c < 3; c++) view.target[c] += unit * (-dx * a.right[c] + dy * a.up[c]);
  }
  const actions = {
    reset: () => { view = copy(start); },
    top: () => { view.azimuth = -Math.PI / 2; view.elevation = Math.PI / 2; },
    bigger: () => { size = Math.min(size * 1.4, 20); },
    smaller: () => { size = Math.max(size / 1.4, 0.2); },
    colour: () => { look = (look + 1) % looks.length; legend(); },
    paths: () => { showPaths = !showPaths; legend(); },
  };
  holder.querySelectorAll("button").forEach((b) => b.addEventListener("click", () => { actions[b.dataset.do](); redraw(); }));
  if (chooser) {
    looks.forEach((k) => chooser.append(new Option(k.name)));
    chooser.addEventListener("change", () => { look = chooser.selectedIndex; legend(); redraw(); });
  }
  window.addEventListener("resize", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  say();
  legend();
  draw();
})();
