// Colours of a scale from low to high (viridis).
import * as THREE from "three";

export const STEPS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"];

export function ramp() {
  const rgba = new Uint8Array(STEPS.flatMap((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)).concat(255)));
  const texture = new THREE.DataTexture(rgba, STEPS.length, 1);
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  return texture;
}
