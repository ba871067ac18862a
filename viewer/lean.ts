// What of three.js the page has no use for, left out as it is built: a third of that library, which no bundler can know to be unused, since its renderer holds all of it.
//
// In: the sources of three.js. Out: its shaders without comments, those of materials and features that the page lacks empty, and parts of its renderer
// replaced by ones that do nothing. Whoever uses such a material in the page is told by the build, not by a black picture.

import { readFileSync } from "node:fs";
import type { Plugin } from "vite";

const SOURCES = "node_modules/three/src/renderers";

/** The materials that the page uses, and the shaders of those that bring none of their own. */
const MATERIALS = ["MeshBasicMaterial", "MeshLambertMaterial", "LineBasicMaterial", "ShaderMaterial"];
const SHADERS = ["meshbasic", "meshlambert"];
/** Features that serve nothing here, by how the names of their parts of these shaders begin; what of such a part is under no `#if` is needed all the same. */
const WITHOUT = [
  "alphahash", "alphamap", "aomap", "batching", "bumpmap", "clipping", "displacementmap", "dithering", "emissivemap", "envmap", "fog", "lightmap", "lights_fragment_maps",
  "logdepthbuf", "morph", "normalmap", "shadowm", "skin", "specularmap",
];
/** Parts of the renderer: what it calls each of them, and what does as much as the page asks of it. */
const NOTHING: Record<string, { as: string; code: string }> = {
  "webgl/WebGLCubeMaps.js": { as: "cubemaps", code: "export const WebGLCubeMaps = function () { return { get: (texture) => texture, dispose() {} }; };" },
  "webgl/WebGLCubeUVMaps.js": { as: "cubeuvmaps", code: "export const WebGLCubeUVMaps = function () { return { get: (texture) => texture, dispose() {} }; };" },
  "webgl/WebGLMorphtargets.js": { as: "morphtargets", code: "export const WebGLMorphtargets = function () { return { update() {} }; };" },
  "webgl/WebGLShadowMap.js": {
    as: "shadowMap",
    code: "export const WebGLShadowMap = function () { return { enabled: false, autoUpdate: false, needsUpdate: false, type: 0, render() {} }; };",
  },
  "webgl/WebGLUniformsGroups.js": { as: "uniformsGroups", code: "export const WebGLUniformsGroups = function () { return { bind() {}, update() {}, dispose() {} }; };" },
  "webxr/WebXRManager.js": {
    as: "xr",
    code: `export class WebXRManager {
      enabled = false; isPresenting = false; cameraAutoUpdate = false;
      addEventListener() {} removeEventListener() {} setAnimationLoop() {} updateCamera() {} getCamera() {} getDepthSensingMesh() {} getEnvironmentBlendMode() {} dispose() {}
      hasDepthSensing() { return false; }
    }`,
  },
};

export function leanThree(): Plugin {
  const [includes, replaced] = [included(), new Set<string>()];
  return {
    name: "lean-three",
    apply: "build",
    enforce: "pre",
    config: () => ({ resolve: { alias: [{ find: /^three$/, replacement: "three/src/Three.js" }] } }),
    transform(code, id) {
      const path = id.split(`/${SOURCES}/`)[1];
      if (path === undefined) {
        const other = id.includes("/node_modules/") ? undefined : [...code.matchAll(/\bTHREE\.(\w+Material)\b/g)].find(([, name]) => name && !MATERIALS.includes(name));
        if (other) this.error(`${id}: lean.ts leaves out the shader of ${other[1]}`);
        return null;
      }
      const nothing = NOTHING[path];
      if (nothing) {
        replaced.add(path);
        return { code: nothing.code, map: null };
      }
      for (const { as, code: given } of Object.values(NOTHING)) {
        const asked = [...code.matchAll(new RegExp(`\\b${as}\\.(\\w+)`, "g"))].find(([, member]) => !new RegExp(`\\b${member}\\b`).test(given));
        if (asked) this.error(`${path} asks for ${asked[0]}, which lean.ts does not give it`);
      }
      const name = /^shaders\/(Shader\w+\/\w+)\.glsl\.js$/.exec(path)?.[1];
      return name === undefined ? null : { code: code.replace(/`([^`]*)`/g, (_, glsl: string) => `\`${includes.has(name) ? withoutComments(glsl) : ""}\``), map: null };
    },
    buildEnd(error) {
      if (error) return;
      const missed = Object.keys(NOTHING).filter((path) => !replaced.has(path));
      if (missed.length > 0) this.error(`three.js has no ${missed.join(", ")} any more: see lean.ts`);
    },
  };
}

/** The shaders, and all parts that they include and the page needs, by path. */
function included(): Set<string> {
  const read = (path: string): string => [...readFileSync(`${SOURCES}/shaders/${path}.glsl.js`, "utf8").matchAll(/`([^`]*)`/g)].map(([, glsl]) => withoutComments(glsl ?? "")).join("");
  const parts = (path: string): string[] => [...read(path).matchAll(/#include <(\w+)>/g)].map(([, part]) => `ShaderChunk/${part}`);
  const isLeftOut = (path: string): boolean => WITHOUT.some((feature) => path.startsWith(`ShaderChunk/${feature}`)) && isConditional(read(path));
  // These it puts into every shader by itself.
  const always = readFileSync(`${SOURCES}/webgl/WebGLProgram.js`, "utf8").matchAll(/ShaderChunk\[ '(\w+)' \]/g);
  const found = new Set([...SHADERS.map((name) => `ShaderLib/${name}`), ...[...always].map(([, part]) => `ShaderChunk/${part}`)]);
  // A set goes on to what is added meanwhile.
  for (const path of found) for (const part of parts(path)) if (!isLeftOut(part)) found.add(part);
  return found;
}

/** Whether every line is between an `#if` and its `#endif`. */
function isConditional(glsl: string): boolean {
  let depth = 0;
  return glsl.split("\n").every((line) => {
    if (/^#\s*if/.test(line)) depth++;
    else if (/^#\s*endif/.test(line)) depth--;
    else return depth > 0 || line === "";
    return true;
  });
}

/** Comments, indentation and the space around operators go; no sign in three.js stands before another one. */
function withoutComments(glsl: string): string {
  const bare = glsl.replace(/\/\*[^]*?\*\/|\/\/.*/g, "").split("\n").map((line) => line.trim()).filter((line) => line !== "");
  // A directive ends with its line.
  return `${bare.map((line) => (line.startsWith("#") ? line : line.replace(/\s*([-+*/=<>!&|?:;,(){}[\]])\s*/g, "$1"))).join("\n")}\n`;
}
