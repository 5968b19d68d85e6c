// Makes src/tiegraph/view/view.js of src/*.js: `npm ci && npm run build`.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const sources = ["build.mjs", "package.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const digest = createHash("sha256");
for (const name of sources) digest.update(`${name}\0`).update(readFileSync(name)).update("\0");

await build({
  entryPoints: ["src/main.js"],
  outfile: "../src/tiegraph/view/view.js",
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2020",
  loader: { ".wasm": "binary" },
  alias: { "cross-fetch": "./src/nofetch.js" },
  legalComments: "none",
  banner: {
    js: `// sha256 of web: ${digest.digest("hex")}\n` +
      "// With three (MIT), copc (MIT) and laz-perf (Apache-2.0): licences.txt",
  },
});
