// The person who wears the sensors, from the front, once there is one; and how an exercise was taught, beside.

import { Vector3 } from "three";
import { el } from "../dom";
import type { Link } from "../link";
import type { Model } from "../model";
import { BodyFigure } from "./body";
import { Ghost } from "./ghost";
import { Room } from "./room";
import { Scene } from "./scene";

export class Person {
  readonly element: HTMLElement;
  private readonly figure = new BodyFigure();
  private readonly ghost = new Ghost();
  private readonly room = new Room();
  private scene: Scene | null = null;
  private drawn = -1;
  /** The exercise that is shown, or asked for. */
  private exercise: string | null = null;

  constructor(id: string, private readonly label: string, private readonly link: Link) {
    this.element = el("div", { id, class: "avatar", hidden: true });
  }

  /** It was hidden meanwhile. */
  shown(): void {
    this.drawn = -1;
  }

  /** Shows how an exercise was taught; null: nobody does. */
  demonstrate(exercise: string | null): void {
    if (exercise === this.exercise) return;
    this.exercise = exercise;
    this.present(null);
    if (exercise === null) return;
    this.link.request({ type: "exercise.demonstration", exercise }).then(
      (demonstration) => {
        if (this.exercise === exercise) this.present(demonstration);
      },
      // Taught from something else than joints, gone, or a replay: there is nothing to show.
      () => {},
    );
  }

  /** Something was taught anew: what is shown may be of before. */
  taught(): void {
    const { exercise } = this;
    this.exercise = null;
    this.demonstrate(exercise);
  }

  draw({ body, looked, version }: Model, now_ms: number): void {
    this.element.hidden = body === null;
    if (body === null) return;
    const changed = this.drawn !== version;
    this.drawn = version;
    const height_m = looked?.height_m ?? null;
    if (changed) {
      if (looked) this.figure.paint(looked.color);
      this.figure.update(body, height_m);
    }
    if (this.scene === null && !this.element.hasChildNodes()) {
      try {
        this.scene = new Scene(this.label, this.room.group);
        this.scene.scene.add(this.figure.group, this.ghost.group);
        this.element.append(this.scene.canvas);
        this.look();
      } catch {
        this.element.append(el("p", {}, "This browser has no WebGL, which the picture needs."));
      }
    }
    if (changed) this.room.under(this.figure.hips);
    const moved = this.ghost.draw(now_ms, this.figure.hips, this.figure.facing, height_m);
    this.scene?.render(changed || moved);
  }

  private present(demonstration: Parameters<Ghost["show"]>[0]): void {
    this.ghost.show(demonstration);
    this.element.dataset.demonstrates = demonstration?.exercise ?? "";
    this.drawn = -1;
    this.look();
  }

  /** From the front, with all who are there in the picture. */
  private look(): void {
    const { hips, facing } = this.figure;
    const two = this.ghost.group.visible;
    this.room.place(hips, facing);
    const at = hips.clone().addScaledVector(Ghost.beside(facing), two ? 0.5 : 0);
    const ahead = new Vector3(Math.cos(facing + 0.35), Math.sin(facing + 0.35), 0.12).multiplyScalar(two ? 3.3 : 2.9);
    this.scene?.look(ahead.add(at), at);
  }
}
