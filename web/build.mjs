// Makes view.js of src/*.js, and laz-perf.wasm beside it, in src/tiegraph/view: `npm ci && npm run build`.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const sources = ["build.mjs", "package.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const digest = createHash("sha256");
for (const name of sources) digest.update(`${name}\0`).update(readFileSync(name)).update("\0");

// Shaders of lights and shadows, which nothing here has.
const unlit = {
  name: "unlit",
  setup: ({ onLoad }) => onLoad({ filter: /Shader(Chunk\/(lights_|shadowm|transmission|iridescence|cube_uv)|Lib\/(mesh(lambert|matcap|normal|phong|physical|toon)|distance|depth|shadow))/ }, ({ path }) => {
    const names = readFileSync(path, "utf8").match(/(?<=export const )\w+/g);
    return { contents: names ? names.map((n) => `export const ${n} = "";`).join("") : 'export default "";' };
  }),
};

writeFileSync("../src/tiegraph/view/laz-perf.wasm", readFileSync("node_modules/laz-perf/lib/web/laz-perf.wasm"));
await build({
  entryPoints: ["src/main.js"],
  outfile: "../src/tiegraph/view/view.js",
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2020",
  alias: {
    "cross-fetch": "./src/nofetch.js",
    "three/addons": "./node_modules/three/examples/jsm",
    three: "./node_modules/three/src/Three.js",
  },
  plugins: [unlit],
  legalComments: "none",
  banner: {
    js: `// sha256 of web: ${digest.digest("hex")}\n` +
      "// With three (MIT), copc (MIT) and laz-perf (Apache-2.0): licences.txt",
  },
});
