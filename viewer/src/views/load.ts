// The views, each fetched when it is first shown: who watches needs no set-up, and who looks at numbers no WebGL.

export const load = {
  watch: () => import("./Watch.svelte"),
  setup: () => import("./Setup.svelte"),
  calibrate: () => import("./Calibrate.svelte"),
  coach: () => import("./Coach.svelte"),
  exercise: () => import("./Exercise.svelte"),
  plan: () => import("./Plan.svelte"),
  analyse: () => import("./Analyse.svelte"),
  takes: () => import("./Takes.svelte"),
  check: () => import("./Check.svelte"),
  wall: () => import("./Wall.svelte"),
  timeline: () => import("../timeline/Timeline.svelte"),
};
