// Geometry whose numbers change with every frame.

import * as THREE from "three";

export function instanced(geometry: THREE.BufferGeometry, material: THREE.Material, count: number): THREE.InstancedMesh {
  const mesh = new THREE.InstancedMesh(geometry, material, Math.max(count, 1));
  mesh.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
  mesh.frustumCulled = false;
  return mesh;
}

export function segments(vertices: number, material: THREE.Material): THREE.LineSegments {
  const geometry = new THREE.BufferGeometry();
  const points = new THREE.BufferAttribute(new Float32Array(Math.max(vertices, 2) * 3), 3).setUsage(THREE.DynamicDrawUsage);
  geometry.setAttribute("position", points);
  const lines = new THREE.LineSegments(geometry, material);
  lines.frustumCulled = false;
  return lines;
}

export function finish(mesh: THREE.InstancedMesh, count: number): void {
  mesh.count = count;
  // What is drawn no times is a call all the same.
  mesh.visible = count > 0;
  mesh.instanceMatrix.needsUpdate = true;
}
