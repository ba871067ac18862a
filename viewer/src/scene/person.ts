// The person who wears the sensors, from the front, once there is one.

import { Vector3 } from "three";
import { el } from "../dom";
import type { Model } from "../model";
import { BodyFigure } from "./body";
import { Scene } from "./scene";

export class Person {
  readonly element: HTMLElement;
  private readonly figure = new BodyFigure();
  private scene: Scene | null = null;
  private drawn = -1;

  constructor(id: string, private readonly label: string) {
    this.element = el("div", { id, class: "avatar", hidden: true });
  }

  /** It was hidden meanwhile. */
  shown(): void {
    this.drawn = -1;
  }

  draw({ body, hello, version }: Model): void {
    this.element.hidden = body === null;
    if (body === null) return;
    const changed = this.drawn !== version;
    this.drawn = version;
    if (changed) this.figure.update(body, hello?.height_m ?? null);
    if (this.scene === null && !this.element.hasChildNodes()) {
      try {
        this.scene = new Scene(this.label);
        this.scene.scene.add(this.figure.group);
        this.element.append(this.scene.canvas);
        const { hips, facing } = this.figure;
        const ahead = new Vector3(Math.cos(facing + 0.35), Math.sin(facing + 0.35), 0.12).multiplyScalar(2.9);
        this.scene.look(ahead.add(hips), hips);
      } catch {
        this.element.append(el("p", {}, "This browser has no WebGL, which the picture needs."));
      }
    }
    this.scene?.render(changed);
  }
}
