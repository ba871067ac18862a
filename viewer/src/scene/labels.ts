// Names that face the camera, all of them in one draw call: quads that share one picture of all texts.

import * as THREE from "three";

const HEIGHT_M = 0.055;
const ROW_PX = 40;
const FONT = "28px system-ui, sans-serif";
/** Texts one above the other before a new column begins: pictures have a largest size. */
const ROWS = 100;
/** Where what is not shown is put. */
const NOWHERE = -1000;

const VERTEX = `
attribute vec3 place;
attribute vec4 cut;
attribute float width;
varying vec2 at;
void main() {
  at = cut.xy + cut.zw * uv;
  vec4 centre = modelViewMatrix * vec4(place, 1.0);
  centre.xy += (uv + vec2(0.1, 0.6)) * vec2(width, ${HEIGHT_M});
  gl_Position = projectionMatrix * centre;
}`;
const FRAGMENT = `
uniform sampler2D texts;
varying vec2 at;
void main() {
  gl_FragColor = texture2D(texts, at);
}`;

export class Labels {
  readonly group = new THREE.Group();
  private mesh: THREE.Mesh<THREE.InstancedBufferGeometry, THREE.ShaderMaterial> | null = null;
  private places = new THREE.InstancedBufferAttribute(new Float32Array(0), 3);

  /** Other texts, in a CSS colour; all are hidden until they are put somewhere. */
  write(texts: string[], colour: string): void {
    this.mesh?.removeFromParent();
    this.mesh?.geometry.dispose();
    this.mesh?.material.uniforms["texts"]!.value.dispose();
    this.mesh?.material.dispose();
    this.mesh = null;
    if (texts.length === 0) return;
    const canvas = document.createElement("canvas");
    const draw = canvas.getContext("2d")!;
    draw.font = FONT;
    const widths = texts.map((text) => Math.ceil(draw.measureText(text).width) + 8);
    const column = Math.max(...widths);
    canvas.width = column * Math.ceil(texts.length / ROWS);
    canvas.height = ROW_PX * Math.min(texts.length, ROWS);
    draw.font = FONT;
    draw.fillStyle = colour;
    draw.textBaseline = "middle";
    const geometry = new THREE.InstancedBufferGeometry();
    geometry.index = QUAD.index;
    for (const name of ["position", "uv"]) geometry.setAttribute(name, QUAD.getAttribute(name));
    const cuts = new Float32Array(4 * texts.length);
    texts.forEach((text, index) => {
      const [x, y] = [column * Math.floor(index / ROWS), ROW_PX * (index % ROWS)];
      draw.fillText(text, x + 4, y + ROW_PX / 2);
      cuts.set([x / canvas.width, 1 - (y + ROW_PX) / canvas.height, widths[index]! / canvas.width, ROW_PX / canvas.height], 4 * index);
    });
    this.places = new THREE.InstancedBufferAttribute(new Float32Array(3 * texts.length).fill(NOWHERE), 3);
    this.places.setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("place", this.places);
    geometry.setAttribute("cut", new THREE.InstancedBufferAttribute(cuts, 4));
    const widths_m = Float32Array.from(widths, (width) => (HEIGHT_M * width) / ROW_PX);
    geometry.setAttribute("width", new THREE.InstancedBufferAttribute(widths_m, 1));
    const material = new THREE.ShaderMaterial({
      vertexShader: VERTEX, fragmentShader: FRAGMENT, transparent: true, depthTest: false, depthWrite: false,
      uniforms: { texts: { value: new THREE.CanvasTexture(canvas) } },
    });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 1;
    this.group.add(this.mesh);
  }

  put(index: number, { x, y, z }: THREE.Vector3): void {
    this.places.setXYZ(index, x, y, z);
  }

  hide(index: number): void {
    this.places.setXYZ(index, NOWHERE, NOWHERE, NOWHERE);
  }

  /** After all have been put. */
  finish(): void {
    this.places.needsUpdate = true;
  }
}

const QUAD = new THREE.PlaneGeometry(1, 1);
