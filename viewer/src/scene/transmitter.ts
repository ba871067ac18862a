// The magnetic transmitter: a cube with its axes, which are the tracker's own, and rings half a metre apart.

import * as THREE from "three";

const RINGS_M = [0.5, 1.0, 1.5];

export function transmitter(): THREE.Group {
  const group = new THREE.Group();
  const cube = new THREE.Mesh(new THREE.BoxGeometry(0.1, 0.1, 0.1), new THREE.MeshLambertMaterial({ color: 0x55585e }));
  group.add(cube, new THREE.AxesHelper(0.2));
  const faint = new THREE.LineBasicMaterial({ color: 0x888888, transparent: true, opacity: 0.35 });
  for (const radius of RINGS_M) {
    const points = new THREE.EllipseCurve(0, 0, radius, radius).getPoints(96);
    group.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(points), faint));
  }
  return group;
}
