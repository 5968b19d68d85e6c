// Rasters of the run draped on their heights, and contour lines.
import * as THREE from "three";

const floats = async (url) => {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error((await answer.json()).error);
  return new Float32Array(await answer.arrayBuffer());
};

// A raster by its number: a mesh of the heights that are known, with the raster's colours.
export async function sheet(number, planes) {
  const [numbers, map] = await Promise.all([floats(`mesh?k=${number}`), new THREE.TextureLoader().loadAsync(`picture?k=${number}`)]);
  const [rows, columns] = numbers, xyz = numbers.subarray(2);
  const uv = [], index = [];
  const known = (k) => Number.isFinite(xyz[3 * k]);
  for (let r = 0; r < rows; r++)
    for (let c = 0; c < columns; c++) {
      const a = r * columns + c, b = a + 1, d = a + columns, e = d + 1;
      uv.push((c + 0.5) / columns, 1 - (r + 0.5) / rows);
      if (r + 1 === rows || c + 1 === columns) continue;
      if (known(b) && known(d)) {
        if (known(a)) index.push(a, d, b);
        if (known(e)) index.push(b, d, e);
      }
    }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(xyz.map((v) => (Number.isFinite(v) ? v : 0)), 3));
  geometry.setAttribute("uv", new THREE.Float32BufferAttribute(uv, 2));
  geometry.setIndex(index);
  const material = new THREE.MeshBasicMaterial({
    map, alphaTest: 0.5, side: THREE.DoubleSide, clippingPlanes: planes,
    polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
  });
  const mesh = new THREE.Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

export async function contours(planes) {
  const xyz = await floats("contours");
  const ends = [];
  for (let k = 0; k + 5 < xyz.length; k += 3)
    if (Number.isFinite(xyz[k]) && Number.isFinite(xyz[k + 3])) ends.push(...xyz.subarray(k, k + 6));
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: "#e8c9a0", clippingPlanes: planes }));
}
