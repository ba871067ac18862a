// The room in 3-D: z up, metres, as the messages say it. Few draw calls whatever the number of sensors.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Quat, Vec3 } from "../protocol";

/** Between two pictures where the processor draws them, ms: what tracks beside the page needs it more. */
const SOFTWARE_MS = 66;

export class Scene {
  readonly scene = new THREE.Scene();
  readonly camera = new THREE.PerspectiveCamera(45, 1, 0.05, 60);
  private readonly renderer: THREE.WebGLRenderer;
  private readonly controls: OrbitControls;
  private moved = true;
  private fits = false;
  private readonly leastMs: number;
  private drawnMs = 0;

  /** `says` is what those hear who do not see it; `ground` what the others stand on. Throws where the browser has no WebGL. */
  constructor(says: string, ground: THREE.Object3D = grid()) {
    // The picture is kept between frames, so that it can be copied.
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    // A program that does not link is a fault of three.js, and to ask whether it does waits for all that is being drawn.
    this.renderer.debug.checkShaderErrors = import.meta.env.DEV;
    this.leastMs = drawsInSoftware(this.renderer.getContext()) ? SOFTWARE_MS : 0;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => (this.moved = true));
    const sun = new THREE.DirectionalLight(0xffffff, 1.7);
    sun.position.set(2, -3, 5);
    // A little from where somebody looks: what is turned to them is never dark.
    const lamp = new THREE.DirectionalLight(0xffffff, 0.9);
    this.camera.add(lamp);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777788, 1.5), sun, this.camera);
    this.scene.add(ground);
    // Asked in every frame, it would lay the page out in every frame.
    new ResizeObserver(() => (this.fits = false)).observe(this.canvas);
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", says);
  }

  get canvas(): HTMLCanvasElement {
    return this.renderer.domElement;
  }

  /** Where the camera looks. */
  get target(): THREE.Vector3 {
    return this.controls.target;
  }

  /** Moves camera and where it looks alike. */
  shift(by: THREE.Vector3): void {
    this.camera.position.add(by);
    this.controls.target.add(by);
    this.controls.update();
  }

  /** Puts the camera somewhere. */
  look(from: THREE.Vector3, at: THREE.Vector3): void {
    this.camera.position.copy(from);
    this.controls.target.copy(at);
    this.controls.update();
  }

  /** Width by height of where it is drawn; 1 before that is known. */
  get aspect(): number {
    const { clientWidth, clientHeight } = this.canvas.parentElement ?? this.canvas;
    return clientHeight > 0 ? clientWidth / clientHeight : 1;
  }

  private fit(): void {
    this.fits = true;
    const { clientWidth, clientHeight } = this.canvas.parentElement ?? this.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    // The canvas is empty now.
    this.moved = true;
    this.drawnMs = -Infinity;
  }

  /** Draws, if something changed. */
  render(changed: boolean): void {
    if (!this.fits) this.fit();
    this.moved ||= changed;
    const nowMs = performance.now();
    if (!this.moved || nowMs - this.drawnMs < this.leastMs) return;
    this.renderer.render(this.scene, this.camera);
    this.drawnMs = nowMs;
    this.moved = false;
  }
}

/** Whether there is no graphics hardware, as the browser tells it. */
function drawsInSoftware(context: WebGLRenderingContext | WebGL2RenderingContext): boolean {
  const info = context.getExtension("WEBGL_debug_renderer_info");
  const name: unknown = info && context.getParameter(info.UNMASKED_RENDERER_WEBGL);
  return typeof name === "string" && /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** A floor to measure by: squares of 25 cm. */
function grid(): THREE.Object3D {
  const grid = new THREE.GridHelper(8, 32, 0x888888, 0x888888);
  grid.rotation.x = Math.PI / 2;
  grid.material.transparent = true;
  grid.material.opacity = 0.25;
  return grid;
}

export function vector([x, y, z]: Vec3, into = new THREE.Vector3()): THREE.Vector3 {
  return into.set(x, y, z);
}

/** From scalar first to scalar last. */
export function quaternion([w, x, y, z]: Quat, into = new THREE.Quaternion()): THREE.Quaternion {
  return into.set(x, y, z, w);
}
