// Numbers and small parts of the page.
export const make = (name, set = {}, ...inside) => {
  const node = Object.assign(document.createElement(name), set);
  node.append(...inside);
  return node;
};

// A length as people read it: in metres, below 0.1 m in millimetres; in a world without a scale as it is.
export const length = (value, unit, digits = 3) => {
  if (value === null) return "not known";
  if (unit !== "m") return `${value.toPrecision(4)} ${unit}`;
  return Math.abs(value) < 0.1 ? `${(value * 1000).toFixed(1)} mm` : `${value.toFixed(digits)} m`;
};

export const axesOf = (layers) => (layers.crs ? ["east", "north", "height"] : ["x", "y", "z"]);

// What the server answers, as JSON; an error is what it says.
export const ask = async (url) => {
  const answer = await fetch(url);
  const found = await answer.json();
  if (!answer.ok) throw new Error(found.error);
  return found;
};
