// A finished run in the browser: the view, what is shown in it, and what is asked of it.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Cameras, tieLines } from "./cameras.js";
import { Cloud, LOOKS } from "./cloud.js";
import { STEPS } from "./colours.js";
import { sayDistance, sayPlace, showImage } from "./said.js";
import { contours, sheet } from "./sheets.js";
import { ask, axesOf, length, make } from "./words.js";

const CLICK_PX = 4, REACH_PX = 8; // a press that moves more turns the view; how near a click has to be
const CAMERA_SIZE = 0.012; // of the distance from which the view is seen
const by = (id) => document.getElementById(id);
const vector = (v) => new THREE.Vector3(...v);
const say = (error) => { by("said").textContent = error.message ?? error; by("said").hidden = false; };

THREE.ColorManagement.enabled = false; // colours are shown as the files have them
start().catch(say);

async function start() {
  const layers = await ask("layers.json");
  document.title = `${layers.name}: tiegraph`;
  by("name").textContent = layers.name;
  by("about").textContent = `${layers.points.toLocaleString("en")} points, ${layers.cameras.length} images, ${layers.crs ?? "no CRS"}`;
  const planes = [1, -1].flatMap((sign) => [0, 1, 2].map((c) => new THREE.Plane(new THREE.Vector3().setComponent(c, sign), Infinity)));
  const stage = new Stage(by("view"), planes);
  const cloud = new Cloud("cloud.copc.laz", layers.middle, planes, (error) => { if (error) say(error); stage.draw(); });
  await cloud.open();
  cloud.look("colour");
  const cameras = new Cameras(layers.cameras);
  Object.assign(stage, { cloud, cameras });
  stage.home();
  listLayers(layers, stage, cloud, cameras, planes);
  listLooks(layers, stage, cloud);
  listClips(layers, stage, cloud, planes);
  by("compass").hidden = !layers.crs;
  by("home").onclick = () => stage.home();
  by("top").onclick = () => stage.top();
  listen(layers, stage, cloud, cameras, planes);
  stage.draw();
}

// The picture: drawn when something has changed, and again until all that it needs is there.
class Stage {
  constructor(canvas, planes) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, logarithmicDepthBuffer: false });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setClearColor("#1b2027");
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(50, 1, 0.1, 1000);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => this.draw());
    this.marks = new THREE.Group();
    this.scene.add(this.marks);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  draw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => { this.asked = null; this.show(); });
  }

  show() {
    if (!this.cloud) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    this.size = { x: width, y: height };
    this.renderer.setSize(width, height, false);
    const away = Math.max(this.camera.position.distanceTo(this.controls.target), 1e-6 * this.radius);
    Object.assign(this.camera, { aspect: width / height, near: away / 200, far: away * 20 + 20 * this.radius });
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.cameras.fit(CAMERA_SIZE * away);
    const whole = this.cloud.update(this.camera, height);
    this.renderer.render(this.scene, this.camera);
    by("count").textContent = `${this.cloud.shown.toLocaleString("en")} points shown${whole ? "" : " …"}`;
    by("north").style.transform = `rotate(${this.controls.getAzimuthalAngle()}rad)`;
    document.body.dataset.state = whole ? "whole" : "loading";
  }

  look(from, at) {
    this.camera.position.copy(from);
    this.controls.target.copy(at);
    this.controls.update();
    this.draw();
  }

  // The cameras and most of the cloud: its far, thin parts would make the rest small.
  whole() {
    const box = this.cloud.most.clone();
    this.cameras.cameras.forEach(({ at }) => box.expandByPoint(vector(at)));
    const size = box.getSize(new THREE.Vector3());
    this.radius = Math.max(size.length() / 2, 1e-6);
    return { centre: box.getCenter(new THREE.Vector3()), size };
  }

  // From the side of the longer extent, obliquely.
  home() {
    const { centre, size } = this.whole();
    const side = vector(size.x >= size.y ? [0.35, -1, 0.75] : [1, -0.35, 0.75]).normalize();
    this.look(centre.clone().addScaledVector(side, 1.9 * this.radius), centre);
  }

  top() {
    const { centre } = this.whole();
    this.look(centre.clone().add(new THREE.Vector3(0, -1e-3, 2.2).multiplyScalar(this.radius)), centre);
  }

  // Crosses at places, and a line between the last two if so wished.
  mark(places, line) {
    this.marks.clear();
    const geometry = new THREE.BufferGeometry().setFromPoints(places.map((p) => vector(p.local)));
    const look = { color: "#ff3b6b", depthTest: false };
    this.marks.add(new THREE.Points(geometry, new THREE.PointsMaterial({ ...look, size: 9 * this.renderer.getPixelRatio(), sizeAttenuation: false })));
    if (line) this.marks.add(new THREE.Line(geometry, new THREE.LineBasicMaterial(look)));
    this.marks.children.forEach((c) => { c.renderOrder = 1; c.frustumCulled = false; });
    this.draw();
  }
}

function tick(name, on, change) {
  const box = make("input", { type: "checkbox", checked: on, onchange: () => change(box.checked) });
  return make("label", {}, box, ` ${name}`);
}

function listLayers(layers, stage, cloud, cameras, planes) {
  const add = (name, object, on) => {
    object.visible = on;
    stage.scene.add(object);
    by("layers").append(tick(name, on, (shown) => { object.visible = shown; stage.draw(); }));
  };
  // What is fetched when it is first wanted.
  const later = (name, fetched) => {
    let object = null;
    by("layers").append(tick(name, false, async (shown) => {
      if (!object) stage.scene.add((object = new THREE.Group()).add(await fetched().catch((e) => (say(e), new THREE.Group()))));
      object.visible = shown;
      stage.draw();
    }));
  };
  add("point cloud", cloud.group, true);
  add("cameras", cameras.group, true);
  add("tie graph", tieLines(layers.cameras, layers.ties), false);
  layers.sheets.forEach((name, k) => later(name, () => sheet(k, planes)));
  if (layers.contours) later("contour lines", () => contours(planes));
}

function listLooks(layers, stage, cloud) {
  const unit = { height: layers.unit, sigma: layers.unit, images: "images" };
  by("ramp").style.background = `linear-gradient(to right, ${STEPS.join(",")})`;
  LOOKS.forEach((name) => by("look").append(make("option", { textContent: name })));
  by("look").onchange = () => {
    const look = by("look").value, range = cloud.ranges[look];
    cloud.look(look);
    by("legend").hidden = !range;
    if (range) {
      const shown = look === "height" ? range.map((v) => v + layers.middle[2]) : range;
      by("ends").replaceChildren(...shown.map((v) => make("span", { textContent: look === "images" ? v : length(v, unit[look], 2) })));
    }
    stage.draw();
  };
  by("size").oninput = () => { cloud.material.uniforms.size.value = Number(by("size").value); stage.draw(); };
}

// A box that is clipped to: at its ends a slider clips nothing.
function listClips(layers, stage, cloud, planes) {
  axesOf(layers).forEach((name, c) => {
    const low = cloud.low[c], high = cloud.high[c];
    const text = make("span");
    const sliders = [0, 1].map((end) => make("input", { type: "range", min: 0, max: 1000, value: 1000 * end, ariaLabel: `${name}, ${end ? "highest" : "lowest"}` }));
    const change = () => {
      const [a, b] = sliders.map((s) => low + (s.value / 1000) * (high - low));
      planes[c].constant = sliders[0].value > 0 ? -a : Infinity;
      planes[c + 3].constant = sliders[1].value < 1000 ? b : Infinity;
      text.textContent = `${(a + layers.middle[c]).toFixed(2)} to ${(b + layers.middle[c]).toFixed(2)}`;
      stage.draw();
    };
    sliders.forEach((s) => { s.oninput = change; });
    change();
    by("clips").append(make("div", {}, make("b", { textContent: name }), " ", text, ...sliders));
  });
  by("unclip").onclick = () => by("clips").querySelectorAll("input").forEach((s, k) => { s.value = 1000 * (k % 2); s.oninput(); });
}

function listen(layers, stage, cloud, cameras, planes) {
  let picks = [], pressed = null, close = () => {};
  const inside = (...xyz) => planes.every((p) => p.distanceToPoint(vector(xyz)) >= 0);
  const place = (event) => { const box = stage.canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  const lookFrom = (number) => {
    const { at, corners } = layers.cameras[number];
    const ahead = corners.reduce((sum, ray) => sum.add(vector(ray)), new THREE.Vector3()).normalize();
    stage.look(vector(at), vector(at).addScaledVector(ahead, 0.3 * stage.radius));
  };
  const open = (number, xy) => {
    close = showImage(by("image"), number, xy, layers, lookFrom);
    cameras.choose(number);
    stage.draw();
  };
  const pick = async (local) => {
    const found = await ask(`pick?at=${local}`);
    const measuring = by("measure").checked && picks.length > 0;
    picks = measuring ? [picks.at(-1), found] : [found];
    by("distance").textContent = measuring ? await sayDistance(...picks, layers) : "";
    by("place").replaceChildren(...sayPlace(found, layers, open));
    by("picked").hidden = false;
    history.replaceState(null, "", `#${found.xyz.map((v) => v.toFixed(3)).join(",")}`);
    stage.mark(picks, measuring);
  };
  const under = ([x, y]) => {
    const camera = cameras.group.visible ? cameras.pick(x, y, stage.camera, stage.size, REACH_PX) : null;
    const point = cloud.group.visible ? cloud.pick(x, y, stage.camera, stage.size, REACH_PX, inside) : null;
    return { camera, point };
  };
  stage.canvas.addEventListener("pointerdown", (event) => { pressed = place(event); });
  stage.canvas.addEventListener("pointerup", (event) => {
    const [x, y] = place(event);
    if (event.button || !pressed || Math.hypot(x - pressed[0], y - pressed[1]) > CLICK_PX) return;
    const { camera, point } = under([x, y]);
    if (camera && !(point && point.depth < camera.depth)) open(camera.number, null);
    else if (point) pick(point.at).catch(say);
  });
  stage.canvas.addEventListener("pointermove", (event) => {
    const [x, y] = place(event);
    const found = event.buttons || !stage.size || !cameras.group.visible ? null : cameras.pick(x, y, stage.camera, stage.size, REACH_PX);
    by("tip").hidden = !found;
    if (!found) return;
    by("tip").textContent = layers.cameras[found.number].name;
    Object.assign(by("tip").style, { left: `${x + 14}px`, top: `${y + 10}px` });
  });
  window.addEventListener("keydown", (event) => { if (event.key === "Escape") close(); });
  by("unpick").onclick = () => {
    picks = [];
    by("picked").hidden = true;
    stage.mark(picks, false);
  };
  const linked = location.hash.slice(1).split(",").map(Number);
  if (linked.length === 3 && linked.every(Number.isFinite)) pick(linked.map((v, c) => v - layers.middle[c])).catch(say);
}
