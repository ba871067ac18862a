// A plain room around a person: floor, walls, and where the person stands on it. It turns with who stands in it, so that the wall is behind.

import * as THREE from "three";

/** From wall to wall, to the ceiling's place, and from the person to the wall behind, m. */
const WIDTH_M = 5;
const HEIGHT_M = 2.6;
const BEHIND_M = 1.5;
const DEPTH_M = 6;
/** Of what touches the floor. */
const SHADOW_M = 0.45;
const COLOURS = {
  light: { floor: 0xcdc7bc, wall: 0xeeece7, side: 0xe4e1da, base: 0xbdb7ac },
  dark: { floor: 0x393836, wall: 0x44474b, side: 0x3c3f43, base: 0x2a2a2a },
};

/** A wall is as bright as it is painted: a lamp would make those grey that it does not shine on. */
function plane(width: number, height: number): THREE.Mesh<THREE.PlaneGeometry, THREE.MeshBasicMaterial> {
  return new THREE.Mesh(new THREE.PlaneGeometry(width, height), new THREE.MeshBasicMaterial());
}

/** A soft dark disc, where somebody stands. */
export function shadow(radius_m = SHADOW_M): THREE.Mesh {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = canvas.getContext("2d");
  if (context) {
    const soft = context.createRadialGradient(32, 32, 4, 32, 32, 32);
    soft.addColorStop(0, "rgb(0 0 0 / 45%)");
    soft.addColorStop(1, "rgb(0 0 0 / 0%)");
    context.fillStyle = soft;
    context.fillRect(0, 0, 64, 64);
  }
  const material = new THREE.MeshBasicMaterial({ map: new THREE.CanvasTexture(canvas), transparent: true, depthWrite: false });
  return new THREE.Mesh(new THREE.CircleGeometry(radius_m, 32), material);
}

export class Room {
  readonly group = new THREE.Group();
  private readonly floor = plane(WIDTH_M, DEPTH_M);
  private readonly walls = [plane(WIDTH_M, HEIGHT_M), plane(DEPTH_M, HEIGHT_M), plane(DEPTH_M, HEIGHT_M)];
  private readonly bases = [plane(WIDTH_M, 0.08), plane(DEPTH_M, 0.08), plane(DEPTH_M, 0.08)];
  private readonly shadow = shadow();

  constructor() {
    const middle_m = DEPTH_M / 2 - BEHIND_M;
    // x ahead of the person, z up; planes look along z as they are made.
    this.floor.position.set(middle_m, 0, 0);
    this.floor.rotation.z = Math.PI / 2;
    const places: [number, number, number][] = [[-BEHIND_M, 0, 0], [middle_m, WIDTH_M / 2, -Math.PI / 2], [middle_m, -WIDTH_M / 2, Math.PI / 2]];
    places.forEach(([x, y, turn], k) => {
      for (const [mesh, up_m, out_m] of [[this.walls[k]!, HEIGHT_M / 2, 0], [this.bases[k]!, 0.04, 0.01]] as const) {
        // Upright, its face to the middle.
        mesh.rotation.order = "ZYX";
        mesh.rotation.set(Math.PI / 2, 0, turn + Math.PI / 2);
        mesh.position.set(x + out_m * Math.cos(turn), y + out_m * Math.sin(turn), up_m);
      }
    });
    this.shadow.position.z = 0.004;
    // From ahead of the person, over the right shoulder of who looks.
    const lamp = new THREE.DirectionalLight(0xffffff, 1.5);
    lamp.position.set(3, 1.5, 3);
    this.group.add(this.floor, this.shadow, ...this.walls, ...this.bases, lamp, lamp.target);
    this.paint(true);
  }

  /** Puts it around who stands at `hips` and looks along `facing`, rad from the room's x. */
  place(hips: THREE.Vector3, facing: number): void {
    this.group.position.set(hips.x, hips.y, 0);
    this.group.rotation.z = facing;
  }

  /** Puts the shadow under who moves in it. */
  under(hips: THREE.Vector3): void {
    this.shadow.position.copy(this.group.worldToLocal(hips.clone()));
    this.shadow.position.z = 0.004;
  }

  paint(isDark: boolean): void {
    const { floor, wall, side, base } = isDark ? COLOURS.dark : COLOURS.light;
    this.floor.material.color.set(floor);
    this.walls.forEach((mesh, k) => mesh.material.color.set(k === 0 ? wall : side));
    for (const mesh of this.bases) mesh.material.color.set(base);
  }
}
