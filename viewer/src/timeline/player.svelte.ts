// The recording that is played: where it stands, its speed, the loop, and the hand that scrubs in it.

import { link, live, model } from "../page.svelte";
import type { StatusMessage } from "../protocol";
import { Looks } from "./looks";
import type { Window } from "./window";

/** Multiples of real time; "max" as fast as it goes. */
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, "max"] as const;
export type Speed = (typeof SPEEDS)[number];
/** Who is closer than this to where they were sent has come from there, s. */
const THERE_S = 1;
/** After the last key the pipeline is sent there, ms. */
const SETTLE_MS = 250;
/** A shorter loop is a press that slipped, s. */
const LEAST_LOOP_S = 0.2;

class Player {
  /** Where the hand is, stage time, s; null: nobody scrubs. */
  hand_s = $state<number | null>(null);
  /** What is played over and over. */
  loop = $state.raw<Window | null>(null);
  loops = $state(false);
  /** Somebody has sought to behind the loop: it goes on there. However late a busy page's next frame is, it comes back otherwise. */
  private left = false;
  /** What a pause goes on with. */
  private before: Speed = 1;
  /** The job of a jump that has not arrived; NaN before its number is known, null: none. */
  private jump = $state.raw<{ job: number; to_s: number; arrived: boolean } | null>(null);
  /** Of a stage that has just answered nothing is known; where a recording begins is looked at until its first frame comes. */
  private opens: "unknown" | "looked" | null = null;
  private settle = 0;
  private readonly looks = new Looks((t_s) => link.request({ type: "replay.look", t_s }), (look) => model.look(look));

  constructor() {
    model.listen((message) => {
      const { jump } = this;
      if (message.type === "hello") {
        // Another recording, or the same over a new connection.
        this.jump = this.hand_s = this.loop = null;
        this.looks.forget();
        this.opens = "unknown";
      }
      if (this.opens === "unknown" && message.type === "status") this.open(message);
      // One that ends the recording is not passed by any frame.
      if (message.type === "status" && message.replay?.ended != null) this.again(Math.max(message.replay.t_s, this.loop?.to_s ?? 0));
      if (message.type === "sensors") {
        if (this.opens === "looked" && !this.scrubs) this.arrive();
        this.opens = null;
        this.again(message.t_s);
        if (jump && Math.abs(message.t_s - jump.to_s) < THERE_S) this.jump = { ...jump, arrived: true };
      }
      if (jump && (message.type === "jobs" || message.type === "sensors")) this.land(message.type === "sensors");
    });
  }

  get replay() {
    return live.status?.replay ?? null;
  }

  /** All of the recording; null on a live stage. */
  get all(): Window | null {
    const { replay } = this;
    return replay && { from_s: replay.begun_s, to_s: Math.max(replay.end_s, replay.begun_s + 1e-3) };
  }

  get paused(): boolean {
    return this.replay?.speed === 0 || this.replay?.ended != null;
  }

  get speed(): Speed | 0 {
    const speed = this.replay?.speed;
    return speed === null || speed === undefined ? "max" : (SPEEDS.find((each) => each === speed) ?? (speed === 0 ? 0 : 1));
  }

  /** Whether the picture shows a moment that is looked at, whatever the pipeline does. */
  get scrubs(): boolean {
    return this.hand_s !== null || this.jump !== null;
  }

  /** Where it stands, as exactly as is known now, s. */
  now_s(): number {
    const { replay, hand_s, jump } = this;
    if (hand_s !== null) return hand_s;
    if (jump) return jump.to_s;
    if (!replay) return 0;
    // Of its last seconds a busy page has maybe seen no frame.
    if (replay.ended != null) return replay.t_s;
    const newest_s = model.sensors?.t_s;
    return newest_s === undefined || newest_s > replay.end_s ? replay.t_s : newest_s;
  }

  /** Shows where it begins: a pipeline may take a second before it says anything. */
  private open({ replay }: StatusMessage): void {
    this.opens = null;
    if (!replay || this.scrubs || model.sensors) return;
    this.opens = "looked";
    this.looks.want(replay.t_s);
  }

  /** The hand is at a time: the picture follows. */
  scrub(t_s: number): void {
    clearTimeout(this.settle);
    this.hand_s = t_s;
    this.looks.want(t_s);
  }

  /** As by a hand that is taken off soon: for keys, which come many at a time. */
  nudge(t_s: number, then: (t_s: number) => void): void {
    this.scrub(t_s);
    this.settle = window.setTimeout(() => then(t_s), SETTLE_MS);
  }

  /** Plays on from a time; what was looked at stays until the pipeline has got there. */
  async seek(t_s: number): Promise<void> {
    clearTimeout(this.settle);
    this.hand_s = null;
    const jump = { job: NaN, to_s: t_s, arrived: false };
    this.jump = jump;
    this.left = this.loop !== null && t_s >= this.loop.to_s;
    this.looks.want(t_s);
    try {
      const { job } = await link.request({ type: "replay.seek", t_s });
      if (this.jump?.to_s !== t_s) return;
      this.jump = { ...this.jump, job };
      this.land(false);
    } catch (error) {
      this.arrive();
      throw error;
    }
  }

  async setSpeed(speed: Speed | 0): Promise<void> {
    if (speed !== 0) this.before = speed;
    await link.request({ type: "replay.speed", speed });
    // At its end there is nothing to play: from the beginning.
    if (speed !== 0 && this.replay?.ended != null && this.all) await this.seek(this.loops && this.loop ? this.loop.from_s : this.all.from_s);
  }

  async toggle(): Promise<void> {
    if (this.paused) return this.setSpeed(this.before);
    if (this.speed !== 0) this.before = this.speed;
    await this.setSpeed(0);
  }

  /** One speed faster or slower. */
  async shift(by: 1 | -1): Promise<void> {
    const at = SPEEDS.indexOf(this.speed === 0 ? this.before : this.speed);
    await this.setSpeed(SPEEDS[Math.min(Math.max(at + by, 0), SPEEDS.length - 1)]!);
  }

  /** Where the loop begins or ends; the other end moves along rather than be passed. */
  setLoop(end: "from_s" | "to_s", t_s: number): void {
    const { all } = this;
    if (!all) return;
    const loop = { ...(this.loop ?? all) };
    if (end === "from_s") {
      loop.from_s = Math.min(Math.max(t_s, all.from_s), all.to_s - LEAST_LOOP_S);
      loop.to_s = Math.max(loop.to_s, loop.from_s + LEAST_LOOP_S);
    } else {
      loop.to_s = Math.max(Math.min(t_s, all.to_s), all.from_s + LEAST_LOOP_S);
      loop.from_s = Math.min(loop.from_s, loop.to_s - LEAST_LOOP_S);
    }
    this.loop = loop;
  }

  /** Back to where the loop begins, once it has run out of it. */
  private again(t_s: number): void {
    const { loop, replay } = this;
    if (!this.loops || !loop || !replay || this.hand_s !== null || this.jump || replay.speed === 0) return;
    if (t_s < loop.to_s) this.left = false;
    else if (!this.left) this.seek(loop.from_s).catch(() => (this.loops = false));
  }

  /** Whether the jump is over: its job has ended, and a frame has come from there. In a pause none may come: what is looked at stays until it is played. */
  private land(isFrame: boolean): void {
    const { jump } = this;
    if (!jump) return;
    const job = model.jobs?.jobs.find((each) => each.job === jump.job);
    if (job && job.state !== "running" && (jump.arrived || isFrame || job.state !== "done")) this.arrive();
  }

  private arrive(): void {
    this.jump = null;
    if (this.hand_s !== null) return;
    this.looks.stop();
    model.look(null);
  }
}

export const player = new Player();
