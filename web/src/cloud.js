// The cloud, streamed from its COPC file: the nodes that the view needs, the coarse ones first.
import { Copc } from "copc";
import { createLazPerf } from "laz-perf";
import * as THREE from "three";
import { ramp } from "./colours.js";

const MOST_POINTS = 4e6; // drawn at once
const AT_ONCE = 4; // nodes on their way
const SPACING_PX = 1.5; // a node is opened where its points are farther apart on the screen
const DIMENSIONS = ["X", "Y", "Z", "Red", "Green", "Blue", "sigma_m", "views"];
export const LOOKS = ["colour", "height", "sigma", "images"];

const VERTEX = `
  #include <clipping_planes_pars_vertex>
  attribute vec3 colour; attribute float sigma; attribute float views;
  uniform int look; uniform vec2 range; uniform float gain, spacing, size, perUnit; uniform sampler2D ramp;
  varying vec3 shown;
  void main() {
    vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * mvPosition;
    gl_PointSize = clamp(1.6 * size * spacing * perUnit / -mvPosition.z, 1.5, 9.0);
    float value = look == 1 ? position.z : look == 2 ? sigma : views;
    float share = (value - range.x) / max(range.y - range.x, 1e-9);
    shown = look == 0 ? min(colour * gain, 1.0) : value == value ? texture2D(ramp, vec2(share, 0.5)).rgb : vec3(0.5);
    #include <clipping_planes_vertex>
  }`;
const FRAGMENT = `
  #include <clipping_planes_pars_fragment>
  varying vec3 shown;
  void main() {
    #include <clipping_planes_fragment>
    vec2 away = gl_PointCoord - 0.5;
    if (dot(away, away) > 0.25) discard;
    gl_FragColor = vec4(shown, 1.0);
  }`;

const quantile = (sorted, share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];

export class Cloud {
  constructor(url, middle, planes, changed) {
    this.url = url;
    this.middle = middle;
    this.changed = changed;
    this.group = new THREE.Group();
    this.nodes = new Map();
    this.loading = 0;
    this.material = new THREE.ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      clipping: true,
      clippingPlanes: planes,
      uniforms: {
        look: { value: 0 }, range: { value: new THREE.Vector2() }, gain: { value: 1 }, spacing: { value: 1 },
        size: { value: 1 }, perUnit: { value: 1 }, ramp: { value: ramp() },
      },
    });
  }

  // Header, hierarchy and root; the extent of most points, and the ranges of what they may be coloured by.
  async open() {
    this.get = async (begin, end) => {
      const answer = await fetch(this.url, { headers: { Range: `bytes=${begin}-${end - 1}` } });
      if (answer.status !== 206) throw new Error(`${this.url}: ${answer.status} ${answer.statusText}`);
      return new Uint8Array(await answer.arrayBuffer());
    };
    this.lazPerf = await createLazPerf({ locateFile: (name) => name });
    this.copc = await Copc.create(this.get);
    const { cube, rootHierarchyPage } = this.copc.info;
    const { nodes } = await Copc.loadHierarchyPage(this.get, rootHierarchyPage);
    const side = cube[3] - cube[0];
    for (const [key, told] of Object.entries(nodes)) {
      const [level, ...cell] = key.split("-").map(Number);
      const edge = side / 2 ** level;
      const low = new THREE.Vector3(...cell.map((c, k) => cube[k] + c * edge - this.middle[k]));
      const box = new THREE.Box3(low, low.clone().addScalar(edge));
      this.nodes.set(key, { key, level, cell, told, box, spacing: this.copc.info.spacing / 2 ** level, points: null });
    }
    for (const node of this.nodes.values())
      node.children = [0, 1, 2, 3, 4, 5, 6, 7]
        .map((k) => [node.level + 1, ...node.cell.map((c, axis) => 2 * c + ((k >> axis) & 1))].join("-"))
        .filter((key) => this.nodes.has(key));
    this.root = this.nodes.get("0-0-0-0");
    if (!this.root) throw new Error("the cloud has no points");
    await this.load(this.root);
    this.survey();
  }

  survey() {
    const { position, colour, sigma, views } = this.root.points.geometry.attributes;
    const axes = [0, 1, 2].map((c) => position.array.filter((_, k) => k % 3 === c).sort());
    this.low = axes.map((v) => quantile(v, 0.005));
    this.high = axes.map((v) => quantile(v, 0.995));
    this.most = new THREE.Box3(...[0.25, 0.75].map((share) => new THREE.Vector3(...axes.map((v) => quantile(v, share)))));
    const known = sigma.array.filter(Number.isFinite).sort();
    const ends = (v, share) => (v.length ? [quantile(v, share), quantile(v, 1 - share)] : [0, 1]);
    this.ranges = { height: ends(axes[2], 0.02), sigma: ends(known, 0.03), images: ends(views.array.slice().sort(), 0.02) };
    const bright = quantile(colour.array.slice().sort(), 0.98);
    this.material.uniforms.gain.value = Math.min(1.7, 250 / Math.max(bright, 1));
  }

  look(name) {
    this.material.uniforms.look.value = LOOKS.indexOf(name);
    if (this.ranges[name]) this.material.uniforms.range.value.set(...this.ranges[name]);
  }

  async load(node) {
    this.loading++;
    try {
      const { pointCount } = node.told;
      const view = await Copc.loadPointDataView(this.get, this.copc, node.told, { lazPerf: this.lazPerf, include: DIMENSIONS });
      const [x, y, z, red, green, blue, s, v] = DIMENSIONS.map((name) =>
        name in view.dimensions ? view.getter(name) : () => NaN);
      const xyz = new Float32Array(3 * pointCount), rgb = new Uint8Array(3 * pointCount);
      const sigma = new Float32Array(pointCount), views = new Uint8Array(pointCount);
      for (let k = 0; k < pointCount; k++) {
        [x, y, z].forEach((of, c) => { xyz[3 * k + c] = of(k) - this.middle[c]; });
        [red, green, blue].forEach((of, c) => { rgb[3 * k + c] = of(k) >> 8; });
        sigma[k] = s(k);
        views[k] = v(k);
      }
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(xyz, 3));
      geometry.setAttribute("colour", new THREE.BufferAttribute(rgb, 3, true));
      geometry.setAttribute("sigma", new THREE.BufferAttribute(sigma, 1));
      geometry.setAttribute("views", new THREE.BufferAttribute(views, 1));
      node.points = new THREE.Points(geometry, this.material);
      node.points.frustumCulled = false; // done by update
      node.points.onBeforeRender = () => {
        this.material.uniforms.spacing.value = node.shownSpacing;
        this.material.uniformsNeedUpdate = true;
      };
      this.group.add(node.points);
    } finally {
      this.loading--;
    }
  }

  // Which nodes are shown and which are fetched, for a camera whose picture is so many pixels high; true: all are there.
  update(camera, height) {
    const perUnit = height / 2 / Math.tan(THREE.MathUtils.degToRad(camera.fov / 2));
    this.material.uniforms.perUnit.value = perUnit * Math.min(window.devicePixelRatio, 2);
    const frustum = new THREE.Frustum().setFromProjectionMatrix(
      new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse));
    const wanted = [];
    const visit = (node) => {
      if (!frustum.intersectsBox(node.box)) return;
      const away = Math.max(node.box.distanceToPoint(camera.position), camera.near);
      node.pixels = (node.spacing * perUnit) / away;
      wanted.push(node);
      if (node.pixels > SPACING_PX) node.children.forEach((key) => visit(this.nodes.get(key)));
    };
    visit(this.root);
    wanted.sort((a, b) => b.pixels - a.pixels);
    let count = 0;
    const kept = wanted.filter((node) => (count += node.told.pointCount) <= MOST_POINTS);
    const shown = new Set(kept);
    this.shown = 0;
    let room = count + MOST_POINTS; // what is not shown is kept while there is room for it
    for (const node of this.nodes.values()) {
      if (!node.points) continue;
      node.points.visible = shown.has(node);
      if (node.points.visible) this.shown += node.told.pointCount;
      room -= node.told.pointCount;
      if (room >= 0 || shown.has(node) || node === this.root) continue;
      this.group.remove(node.points);
      node.points.geometry.dispose();
      node.points = null;
    }
    kept.slice().reverse().forEach((node) => {
      const finer = node.children.map((key) => this.nodes.get(key)).filter((n) => n.points?.visible);
      node.shownSpacing = finer.length ? Math.min(...finer.map((n) => n.shownSpacing ?? n.spacing)) : node.spacing;
    });
    this.queue = kept.filter((node) => !node.points && !node.asked);
    this.fetch();
    return !this.loading;
  }

  // The next nodes, some at a time, whether or not what came before is drawn yet.
  fetch() {
    while (this.loading < AT_ONCE && this.queue.length) {
      const node = this.queue.shift();
      node.asked = true;
      this.load(node).then(() => this.changed(), (error) => this.changed(error)).finally(() => {
        node.asked = false;
        this.fetch();
      });
    }
  }

  // The point under a place of the screen: of those within so many pixels the nearest to the viewer, or null.
  pick(x, y, camera, size, reach, inside) {
    const m = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2((2 * x) / size.x - 1, 1 - (2 * y) / size.y), camera);
    let best = null, least = Infinity;
    for (const node of this.nodes.values()) {
      if (!node.points?.visible) continue;
      const away = node.box.distanceToPoint(camera.position) + node.box.getSize(new THREE.Vector3()).length();
      const near = node.box.clone().expandByScalar((away * reach) / this.material.uniforms.perUnit.value);
      if (!caster.ray.intersectsBox(near)) continue;
      const p = node.points.geometry.attributes.position.array;
      for (let k = 0; k < p.length; k += 3) {
        const w = m[3] * p[k] + m[7] * p[k + 1] + m[11] * p[k + 2] + m[15];
        if (w <= 0) continue;
        const dx = ((m[0] * p[k] + m[4] * p[k + 1] + m[8] * p[k + 2] + m[12]) / w / 2 + 0.5) * size.x - x;
        const dy = (0.5 - (m[1] * p[k] + m[5] * p[k + 1] + m[9] * p[k + 2] + m[13]) / w / 2) * size.y - y;
        const off = Math.hypot(dx, dy), cost = w * (1 + 0.02 * off);
        if (off < reach && cost < least && inside(p[k], p[k + 1], p[k + 2])) {
          least = cost;
          best = { at: [p[k], p[k + 1], p[k + 2]], depth: w };
        }
      }
    }
    return best;
  }
}
