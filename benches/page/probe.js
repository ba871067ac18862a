// Runs before the page's own scripts: times its callbacks, counts messages, states when a tab that was hidden is current, and when
// the body was first drawn moved after the page was opened.

window.probe = (() => {
  const costs_ms = [];
  let sum_ms = 0;
  let messages = 0;
  let shown_ms = null;
  let newest_ms = -Infinity;
  let current_ms = null;
  let first = null;
  let has_moved = false;
  let moved_ms = null;
  /** A jump: when it was pressed, the looks that were asked for since, whether one has come, when it was drawn; when frames came from there. */
  let pressed_ms = null;
  let wished_s = null;
  let asked = new Set();
  let answered_ms = null;
  let looked_ms = null;
  let arrived_ms = null;
  /** Answers to looks. */
  let looks = 0;
  /** Whether a pose has come, of a frame or of a look, and when the frame after it was over. */
  let has_posed = false;
  let first_ms = null;

  /** Whether the body is no longer where the first message of it had it: by a quarter of a degree. */
  const moves = (data) => {
    if (typeof data !== "string" || !data.includes('"type":"body"')) return false;
    const turns = JSON.parse(data).segments.flatMap((segment) => segment.orientation_wxyz ?? []);
    first ??= turns;
    return turns.some((part, i) => Math.abs(part - first[i]) > 0.002);
  };

  const timed = (callback, argument) => {
    const from = performance.now();
    callback(argument);
    sum_ms += performance.now() - from;
  };

  const request = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) => request((now) => {
    timed(callback, now);
    costs_ms.push(sum_ms);
    if (costs_ms.length > 100000) costs_ms.shift();
    sum_ms = 0;
    if (answered_ms !== null) looked_ms ??= performance.now() - pressed_ms;
    if (has_posed) first_ms ??= performance.now();
    if (has_moved) moved_ms ??= performance.now();
    if (shown_ms !== null && newest_ms > shown_ms && current_ms === null) current_ms = performance.now() - shown_ms;
  });

  const jump = (data) => {
    if (typeof data !== "string") return;
    has_posed ||= data.includes('"type":"sensors"');
    if (pressed_ms === null && has_posed) return;
    const message = JSON.parse(data);
    has_posed ||= message.type === "ok" && asked.has(message.id);
    if (pressed_ms === null) return;
    if (message.type === "ok" && asked.has(message.id)) looks++, answered_ms ??= performance.now() - pressed_ms;
    // Frames of before are on their way still.
    if (message.type === "sensors" && wished_s !== null && Math.abs(message.t_s - wished_s) < 0.5) arrived_ms ??= performance.now() - pressed_ms;
  };
  addEventListener("pointerdown", () => (pressed_ms ??= performance.now()), true);

  window.WebSocket = class extends WebSocket {
    send(data) {
      const request = typeof data === "string" ? JSON.parse(data) : {};
      if (request.type === "replay.look") asked.add(request.id);
      if (request.type === "replay.seek") wished_s = request.t_s;
      super.send(data);
    }
    constructor(url, protocols) {
      super(window.probe.url ?? url, protocols);
    }
    set onmessage(callback) {
      super.onmessage = (event) => {
        messages++;
        newest_ms = performance.now();
        timed(callback, event);
        has_moved ||= moves(event.data);
        jump(event.data);
      };
    }
  };

  document.addEventListener("visibilitychange", () => {
    shown_ms = document.hidden ? null : performance.now();
    current_ms = null;
  });

  return {
    /** Another websocket in the place of the daemon's. */
    url: window.probeUrl ?? null,
    begin() {
      costs_ms.length = 0;
      sum_ms = 0;
      messages = looks = 0;
    },
    looks: () => looks,
    /** From the opening to the end of the first frame with a pose. */
    first_ms: () => first_ms,
    reported() {
      const sorted = costs_ms.toSorted((a, b) => a - b);
      const at = (part) => sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))] ?? 0;
      return { frames: sorted.length, messages, p50_ms: at(0.5), p95_ms: at(0.95), p99_ms: at(0.99) };
    },
    messages: () => messages,
    /** Waits for a press from now on. */
    jumps() {
      pressed_ms = wished_s = answered_ms = looked_ms = arrived_ms = null;
      asked = new Set();
    },
    jumped_ms: () => performance.now() - (pressed_ms ?? Infinity),
    /** From the press to the daemon's answer. */
    answered_ms: () => answered_ms,
    /** From the press to the end of the frame that draws what was asked for. */
    looked_ms: () => looked_ms,
    /** From the press to the first frames of the replay from there. */
    arrived_ms: () => arrived_ms,
    current_ms: () => current_ms,
    /** From the opening to the end of the first frame with a body that has moved. */
    moved_ms: () => moved_ms,
  };
})();
