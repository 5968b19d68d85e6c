// What is said of a place that was picked, and the images that see it.
import { ask, axesOf, length, make } from "./words.js";

const PATCH = 160; // pixels of an image around a place
const MOST_PATCHES = 24;

export function sayPlace(found, layers, open) {
  const unit = layers.unit === "m" ? " m" : "", row = (name, ...value) => make("tr", {}, make("th", { textContent: name }), make("td", {}, ...value));
  const digits = layers.unit === "m" ? 3 : 6;
  const rows = axesOf(layers).map((name, c) => row(name, found.xyz[c].toFixed(digits) + unit));
  if (found.geodetic) {
    const [lat, lon, height] = found.geodetic;
    rows.push(row("lat, lon", `${lat.toFixed(8)}, ${lon.toFixed(8)}`));
    if (Math.abs(height - found.xyz[2]) > 5e-4) rows.push(row("on the ellipsoid", `${height.toFixed(3)} m`));
  }
  const { world, placed, model, point } = found.sigma, said = (v) => length(v, layers.unit);
  rows.push(row("sigma", make("b", { textContent: world === null ? "in the world: not known" : said(world) })));
  if (placed) rows.push(row("· place", `east ${said(placed[0])}, north ${said(placed[1])}, up ${said(placed[2])}`));
  rows.push(row("· model", said(model)), row("· point", said(point)), row("depth maps", `${found.views}`));
  const of = (hidden) => found.images.filter((i) => i.hidden === hidden);
  const seen = of(false), unsure = of(null), behind = of(true).length;
  const counted = [
    seen.length && `${seen.length} see it`, unsure.length && `${unsure.length} may: no depth there (pale)`, behind && `hidden from ${behind}`,
  ];
  const head = `Images: ${counted.filter(Boolean).join(", ") || "none"}`;
  const patches = make("div", { className: "patches" }, ...[...seen, ...unsure].slice(0, MOST_PATCHES).map((i) => patch(i, layers, open)));
  return [make("table", {}, ...rows), make("p", { textContent: head }), patches];
}

function patch({ image, xy, hidden }, layers, open) {
  const [left, top] = xy.map((v) => Math.round(v - PATCH / 2));
  const { name } = layers.cameras[image];
  const picture = make("img", { src: `patch?k=${image}&left=${left}&top=${top}&size=${PATCH}`, alt: name, loading: "lazy" });
  const figure = make("button", { title: name, onclick: () => open(image, xy) }, picture, cross([xy[0] - left, xy[1] - top], [PATCH, PATCH]));
  return make("figure", { className: hidden === null ? "pale" : "" }, figure, make("figcaption", { textContent: name }));
}

function cross(at, size) {
  const mark = make("i", { className: "cross" });
  mark.style.left = `${(100 * at[0]) / size[0]}%`;
  mark.style.top = `${(100 * at[1]) / size[1]}%`;
  return mark;
}

// An image over the view, with a mark where a place is; again or Escape closes it.
export function showImage(holder, number, xy, layers, goThere) {
  const { name, size } = layers.cameras[number];
  const close = () => { holder.hidden = true; holder.replaceChildren(); };
  const frame = make("div", { className: "frame" }, make("img", { src: `image?k=${number}&width=2048`, alt: name }));
  if (xy) frame.append(cross(xy, size));
  frame.style.aspectRatio = `${size[0]} / ${size[1]}`;
  frame.style.setProperty("--ratio", size[0] / size[1]);
  holder.replaceChildren(
    make("header", {}, make("b", { textContent: name }), ` ${size[0]} × ${size[1]}${xy ? ` · pixel ${xy[0].toFixed(1)}, ${xy[1].toFixed(1)}` : ""}`,
      make("button", { textContent: "look from here", onclick: () => { close(); goThere(number); } }),
      make("button", { textContent: "close", onclick: close })),
    frame);
  holder.hidden = false;
  return close;
}

export async function sayDistance(a, b, layers) {
  const sigmas = [a, b].map((p) => p.sigma.point ?? 0);
  const { distance, sigma, level, height } = await ask(`apart?at=${[...a.local, ...b.local]}&sigma=${sigmas}`);
  const said = (v) => length(v, layers.unit), about = sigma === null ? "" : ` ± ${said(sigma)}`;
  return `distance ${said(distance)}${about} · level ${said(level)} · height difference ${said(height)}`;
}
