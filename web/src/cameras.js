// Cameras as frusta, and the tie graph between their projection centres.
import * as THREE from "three";
import { STEPS } from "./colours.js";

export class Cameras {
  constructor(cameras) {
    this.cameras = cameras;
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#ff9d3c" }));
    this.chosen = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#ffffff", depthTest: false }));
    this.group = new THREE.Group().add(this.lines, this.chosen);
    this.size = 0;
  }

  // Frusta of about a size.
  fit(size) {
    if (Math.abs(Math.log(size / this.size)) < 0.2) return;
    this.size = size;
    draw(this.lines, this.cameras.flatMap((camera) => frustum(camera, size)));
    this.choose(this.number ?? null);
  }

  choose(number) {
    this.number = number;
    draw(this.chosen, number === null ? [] : frustum(this.cameras[number], 1.5 * this.size));
  }

  // Number of the camera whose centre is under a place of the screen, the nearest to the viewer, and its depth.
  pick(x, y, camera, screen, reach) {
    let best = null;
    this.cameras.forEach(({ at }, number) => {
      const v = new THREE.Vector3(...at).project(camera);
      if (v.z > 1 || Math.hypot((v.x / 2 + 0.5) * screen.x - x, (0.5 - v.y / 2) * screen.y - y) > reach) return;
      const depth = new THREE.Vector3(...at).applyMatrix4(camera.matrixWorldInverse).z * -1;
      if (!best || depth < best.depth) best = { number, depth };
    });
    return best;
  }
}

const draw = (lines, numbers) => {
  lines.geometry.dispose();
  lines.geometry = new THREE.BufferGeometry();
  lines.geometry.setAttribute("position", new THREE.Float32BufferAttribute(numbers, 3));
  lines.frustumCulled = false;
};

const frustum = ({ at, corners }, size) => {
  const ends = corners.map((ray) => ray.map((v, c) => at[c] + size * v));
  const top = [0, 1, 2].map((c) => (1.5 * (ends[0][c] + ends[1][c]) - 0.5 * (ends[2][c] + ends[3][c])) / 2);
  return ends.flatMap((end, k) => [...at, ...end, ...end, ...ends[(k + 1) % 4]]).concat(ends[0], top, top, ends[1]);
};

// The ties, [row, row, matches] with the weakest first, coloured by their rank.
export function tieLines(cameras, ties) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(ties.flatMap(([i, j]) => [...cameras[i].at, ...cameras[j].at]), 3));
  const colours = STEPS.map((hex) => new THREE.Color(hex));
  const rgb = ties.flatMap((_, k) => {
    const { r, g, b } = colours[Math.floor((k / ties.length) * colours.length)];
    return [r, g, b, r, g, b];
  });
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(rgb, 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, opacity: 0.8 }));
}
