// The top view and the gate's last seconds.

const SECONDS = 10;
const LEAST = 0.001; // the p-value at the bottom of the strip

function pen(canvas) {
  const scale = devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

function arrow(context, [x, y], [right, up], length, colour, width, dash) {
  if (Math.hypot(right, up) < 0.01) return;
  const to = [x + right * length, y - up * length];
  const angle = Math.atan2(to[1] - y, to[0] - x);
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(...to);
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  for (const turn of [0, 2.5, -2.5]) {
    context.lineTo(to[0] + 9 * Math.cos(angle + turn), to[1] + 9 * Math.sin(angle + turn));
  }
  context.fill();
}

export function top(canvas, scene, about, trail, state) {
  const [context, width, height] = pen(canvas);
  const colour = colours();
  const [left, above, right, below] = scene.bounds;
  const scale = Math.min(width / (right - left), height / (below - above));
  const at = ([x, y]) => [
    width / 2 + (x - (left + right) / 2) * scale,
    height / 2 + (y - (above + below) / 2) * scale,
  ];
  for (const line of scene.lines) {
    context.strokeStyle = colour(line.kind === "goal" ? "good" : "rule");
    context.lineWidth = line.kind === "goal" ? 5 : 2;
    context.beginPath();
    context.moveTo(...at(line.from));
    context.lineTo(...at(line.to));
    context.stroke();
  }
  context.fillStyle = colour("obstacle");
  for (const [x, y, radius] of [...scene.circles, ...(state.objects || [])]) {
    context.beginPath();
    context.arc(...at([x, y]), radius * scale, 0, 7);
    context.fill();
  }
  context.strokeStyle = context.fillStyle = colour("good");
  context.lineWidth = 2;
  context.font = "600 13px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  const numbers = new Map(); // what is to be reached twice has both numbers
  about.targets.forEach((place, i) => numbers.set(`${place}`, [...(numbers.get(`${place}`) || []), i + 1]));
  for (const [place, which] of numbers) {
    const [x, y] = at(place.split(",").map(Number));
    context.beginPath();
    context.arc(x, y, scene.target_radius * scale, 0, 7);
    context.setLineDash([4, 4]);
    context.stroke();
    context.setLineDash([]);
    if (about.targets.length > 1) context.fillText(which.join(", "), x, y);
  }
  if (state.due) {
    context.lineWidth = 5;
    context.beginPath();
    context.arc(...at(state.due), scene.target_radius * scale, 0, 7);
    context.stroke();
  }
  context.lineWidth = 3;
  for (let i = 1; i < trail.length; i++) {
    context.strokeStyle = colour(trail[i][2] ? "executed" : "faint");
    context.beginPath();
    context.moveTo(...at(trail[i - 1]));
    context.lineTo(...at(trail[i]));
    context.stroke();
  }
  const here = at(state.place);
  context.fillStyle = colour("ink");
  context.beginPath();
  context.arc(...here, 6, 0, 7);
  context.fill();
  const length = 0.16 * width;
  arrow(context, here, state.executed, length, colour("executed"), 6, []);
  arrow(context, here, state.sent, length, colour("sent"), 3, [7, 5]);
  if (scene.height) gauge(context, scene.height, state, height, length, colour);
}

// How high what is steered is, at the left edge: the higher the bar, the higher it is.
function gauge(context, { range: [low, high], marks }, state, height, length, colour) {
  const x = 14;
  const up = (z) => height - 12 - (height - 24) * Math.min(1, Math.max(0, (z - low) / (high - low)));
  context.strokeStyle = colour("rule");
  context.lineWidth = 4;
  context.beginPath();
  context.moveTo(x, up(low));
  context.lineTo(x, up(high));
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillStyle = colour("faint");
  context.lineWidth = 2;
  for (const [name, z] of Object.entries({ ...marks, ...(state.heights || {}) })) {
    context.beginPath();
    context.moveTo(x - 7, up(z));
    context.lineTo(x + 7, up(z));
    context.stroke();
    context.fillText(name, x + 11, up(z));
  }
  const here = [x, up(state.height)];
  context.fillStyle = colour("ink");
  context.beginPath();
  context.arc(...here, 6, 0, 7);
  context.fill();
  arrow(context, here, [0, state.executed[2]], 0.4 * length, colour("executed"), 6, []);
  arrow(context, here, [0, state.sent[2]], 0.4 * length, colour("sent"), 3, [5, 4]);
}

export function strip(canvas, states, settings, rate) {
  const [context, width, height] = pen(canvas);
  const colour = colours();
  const steps = SECONDS * rate;
  const up = (p) => 8 + (height - 16) * (Math.log(Math.max(p, LEAST)) / Math.log(LEAST));
  const shown = states.slice(-steps);
  shown.forEach((state, i) => {
    const x = width - ((shown.length - i) * width) / steps;
    const wide = width / steps;
    if (state.edited) {
      context.globalAlpha = 0.25;
      context.fillStyle = colour("executed");
      context.fillRect(x, 0, wide + 0.5, height);
      context.globalAlpha = 1;
    }
    if (state.p !== null) {
      context.fillStyle = colour(state.p > settings.alpha ? "good" : "bad");
      context.beginPath();
      context.arc(x + wide / 2, up(state.p), 2.5, 0, 7);
      context.fill();
    }
  });
  context.strokeStyle = colour("faint");
  context.setLineDash([5, 4]);
  context.beginPath();
  context.moveTo(0, up(settings.alpha));
  context.lineTo(width, up(settings.alpha));
  context.stroke();
  context.setLineDash([]);
  context.fillStyle = colour("faint");
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "bottom";
  context.fillText("alpha", 6, up(settings.alpha) - 2);
}

export const KEPT_SECONDS = SECONDS;
