// Another take over the one that is played: its people see-through in the same room, from both beginnings on.

import { takePage } from "../library/where";
import { Link } from "../link";
import { model } from "../page.svelte";
import type { ReplayStatus } from "../protocol";
import { Looks } from "./looks";
import { player } from "./player.svelte";

class Beside {
  /** Its name; null: none. */
  name = $state<string | null>(null);
  /** So much later than the one that is played it is shown, s. */
  shift_s = $state(0);
  private link: Link | null = null;
  private looks: Looks | null = null;
  private replay: ReplayStatus | null = null;
  private asked_s = NaN;

  show(name: string | null): void {
    this.link?.close();
    this.looks?.stop();
    [this.link, this.looks, this.replay, this.asked_s] = [null, null, null, NaN];
    model.lookBeside(null);
    this.name = name;
    if (name === null) return;
    const link: Link = new Link(
      (message) => {
        if (message.type === "hello") {
          // It is looked at, and need not play; who may only watch leaves it as it is.
          link.request({ type: "replay.speed", speed: 0 }).catch(() => {});
        }
        if (message.type === "status") this.replay = message.replay;
      },
      () => {},
      () => new URL(takePage(name), location.href).href,
      false,
    );
    link.subscribe({ topics: ["status"] });
    this.link = link;
    this.looks = new Looks((t_s) => link.request({ type: "replay.look", t_s }), (look) => model.lookBeside(look));
    link.connect();
  }

  /** Once per picture: asks for the moment that belongs to the one that is shown. */
  follow(): void {
    const { all } = player;
    if (!this.looks || !this.replay || !all) return;
    const t_s = this.replay.begun_s + player.now_s() - all.from_s - this.shift_s;
    if (t_s === this.asked_s) return;
    this.asked_s = t_s;
    this.looks.want(Math.min(Math.max(t_s, this.replay.begun_s), this.replay.end_s));
  }
}

export const beside = new Beside();
