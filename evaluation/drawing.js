// What the replay and the playground share: the room from above, curves, and strips of activations.
"use strict";
const $ = id => document.getElementById(id);
const svg = (name, attributes, ...children) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  element.append(...children);
  return element;
};
const points = list => list.map(p => `${p[0]},${-p[1]}`).join(" ");  // y is up in a room
const bytes = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
const colour = name => getComputedStyle(document.body).getPropertyValue(name);
const LINE = {fill: "none", "stroke-width": 0.03, "stroke-linejoin": "round"};

function showBounds(map, [low, high]) {
  map.setAttribute("viewBox", `${low[0]} ${-high[1]} ${high[0] - low[0]} ${high[1] - low[1]}`);
}

function targetShape(cube, hidden) {  // a cube in a ring; only its outline if it is hidden
  return [svg("circle", {r: cube, fill: "transparent", "stroke-width": 0.03,
                         style: "stroke: var(--robot)"}),
          svg("rect", {x: -cube / 2, y: -cube / 2, width: cube, height: cube,
                       style: "stroke: var(--cube); fill: " + (hidden ? "none" : "var(--cube)"),
                       "stroke-width": 0.02})];
}

function robotShape(radius) {
  return [svg("circle", {r: radius, style: "fill: var(--robot)"}),
          svg("line", {x2: radius, "stroke-width": 0.04, style: "stroke: var(--back)"})];
}

function place(shape, [x, y, heading = 0]) {
  shape.setAttribute("transform",
                     `translate(${x} ${-y}) rotate(${-heading * 180 / Math.PI})`);
}

function prepare(canvas) {  // for sharp drawing on every screen; returns context, width, height
  const height = Number(canvas.dataset.height || (canvas.dataset.height = canvas.height));
  const width = canvas.clientWidth, ratio = window.devicePixelRatio || 1;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  canvas.style.height = `${height}px`;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  return [context, width, height];
}

// Draws curves of `steps` steps: each [values, low, high, colour], a value per step. `now` is the
// step of the cursor, or null.
function drawCurves(canvas, curves, steps, now) {
  const [context, width, height] = prepare(canvas);
  context.strokeStyle = colour("--line");
  context.strokeRect(0.5, 0.5, width - 1, height - 1);
  for (const [values, low, high, name] of curves) {
    const y = value => height - 4 - (height - 8) * (value - low) / (high - low || 1);
    context.strokeStyle = colour("--line");
    context.beginPath(); context.moveTo(0, y(0)); context.lineTo(width, y(0)); context.stroke();
    context.strokeStyle = colour(name);
    context.lineWidth = 1.6;
    context.beginPath();
    values.forEach((value, t) => {
      context.lineTo(width * t / steps, y(value));
      context.lineTo(width * (t + 1) / steps, y(value));
    });
    context.stroke();
    context.lineWidth = 1;
  }
  drawCursor(context, width, height, steps, now, colour("--front"));
}

function drawCursor(context, width, height, steps, now, shade) {
  if (now === null) return;
  context.fillStyle = shade;
  context.fillRect(width * now / steps - 1, 0, 2, height);
}

// Returns a picture of activations with a column per step: arrays of values from -1 to 1.
function pictureOf(columns) {
  const units = columns[0].length, picture = document.createElement("canvas");
  picture.width = columns.length;
  picture.height = units;
  const image = new ImageData(columns.length, units);
  columns.forEach((values, t) => values.forEach((value, k) => {
    const shade = value < 0 ? [31, 79, 216] : [215, 90, 10], paper = 244;
    const fraction = Math.min(Math.abs(value), 1), at = 4 * (k * columns.length + t);
    shade.forEach((part, c) => { image.data[at + c] = paper + (part - paper) * fraction; });
    image.data[at + 3] = 255;
  }));
  picture.getContext("2d").putImageData(image, 0, 0);
  return picture;
}

function drawStrip(canvas, picture, steps, now) {  // `picture` has a column per step
  const [context, width, height] = prepare(canvas);
  context.imageSmoothingEnabled = false;
  context.drawImage(picture, 0, 0, width * picture.width / steps, height);
  drawCursor(context, width, height, steps, now, "#1c1c1c");
}

function fact(name, value) {
  return `<tr><th scope="row">${name}</th><td>${value}</td></tr>`;
}
