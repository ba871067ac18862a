import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";
import { leanThree } from "./lean";

// Built by cargo (build.rs), which states where to: nothing is written beside the sources.
export default defineConfig({
  base: "./",
  plugins: [svelte(), leanThree()],
  build: { target: "es2022", assetsInlineLimit: 0, chunkSizeWarningLimit: 1000, modulePreload: { polyfill: false },
    // The page of a stage, the one of a hub, and the one that makes a phone a sensor.
    rollupOptions: { input: ["index.html", "hub.html", "phone.html"] },
  },
});
