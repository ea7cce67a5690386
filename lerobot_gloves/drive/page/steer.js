// Keys, gamepad, mouse and touch, as one stick: x to the right and y up, in [-1, 1], never longer than 1; where the task
// has them z, the height, and grip, 1 to close the fingers and -1 to open them.

const KEYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  KeyA: [-1, 0], KeyD: [1, 0], KeyW: [0, 1], KeyS: [0, -1],
};
const HEIGHT = { KeyE: 1, PageUp: 1, KeyQ: -1, PageDown: -1 };
const DEAD = 0.15; // a gamepad's stick is never quite at its centre

const down = new Set();
const raised = new Set(); // what is pressed for the height: keys and buttons of the page
let dragged = null, closed = false, gripping = false, listens = [];

function shortened(x, y) {
  const length = Math.hypot(x, y);
  return length > 1 ? [x / length, y / length] : [x, y];
}

function gamepads() {
  return [...(navigator.getGamepads ? navigator.getGamepads() : [])].filter((pad) => pad && pad.connected);
}

const presses = (pad, i) => (pad.buttons[i] && pad.buttons[i].pressed ? 1 : 0);

function gamepad() {
  for (const pad of gamepads()) {
    const pressed = (i) => presses(pad, i);
    const x = pressed(15) - pressed(14), y = pressed(12) - pressed(13);
    if (x || y) return shortened(x, y);
    const [right = 0, below = 0] = pad.axes;
    if (Math.hypot(right, below) > DEAD) return shortened(right, -below);
  }
  return [0, 0];
}

function height() {
  const keys = [...raised].reduce((sum, one) => sum + one, 0);
  if (keys) return Math.sign(keys);
  for (const pad of gamepads()) {
    const shoulders = presses(pad, 5) - presses(pad, 4);
    if (shoulders) return shoulders;
    const up = -(pad.axes[3] || 0);
    if (Math.abs(up) > DEAD) return Math.max(-1, Math.min(1, up));
  }
  return 0;
}

// What the task has keys for, of "height" and "grip"; the fingers begin open.
export function begin(keys) {
  listens = keys;
  closed = false;
}

export function grip(close = !closed) {
  closed = close;
  return closed;
}

// The whole stick, as a command's fields.
export function stick() {
  const [x, y] = position();
  const now = gamepads().some((pad) => presses(pad, 0)); // a gamepad tells no moment of its presses
  if (now && !gripping) grip();
  gripping = now;
  return { x, y, z: listens.includes("height") ? height() : 0, grip: listens.includes("grip") ? (closed ? 1 : -1) : 0 };
}

function position() {
  if (down.size) {
    const sum = [...down].reduce(([x, y], key) => [x + KEYS[key][0], y + KEYS[key][1]], [0, 0]);
    return shortened(...sum);
  }
  return dragged || gamepad();
}

// Whether an element uses a key itself: sliders and choices the arrows, a list letters as well.
function own(element, code) {
  return element.matches("select") || (element.matches("input") && code.startsWith("Arrow"));
}

// `lift`: buttons of the page and the way, 1 or -1, that each of them goes while it is held.
export function install(pad, lift, moved) {
  const release = () => {
    down.clear();
    raised.clear();
    dragged = null;
    moved();
  };
  const lifts = (code) => listens.includes("height") && code in HEIGHT;
  addEventListener("keydown", (event) => {
    if (!(event.code in KEYS || lifts(event.code)) || event.ctrlKey || event.altKey || event.metaKey || own(event.target, event.code)) return;
    event.preventDefault(); // the page would scroll
    if (!event.repeat) {
      if (lifts(event.code)) raised.add(HEIGHT[event.code]);
      else down.add(event.code);
      moved();
    }
  });
  addEventListener("keyup", (event) => {
    if (down.delete(event.code) || raised.delete(HEIGHT[event.code])) moved();
  });
  for (const [button, way] of lift) {
    const letGo = () => raised.delete(way) && moved();
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      raised.add(way);
      moved();
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, letGo);
  }
  addEventListener("blur", release);
  document.addEventListener("visibilitychange", () => document.hidden && release());

  const drag = (event) => {
    const box = pad.getBoundingClientRect();
    const radius = box.width / 2;
    dragged = shortened((event.clientX - box.left - radius) / radius, (box.top + radius - event.clientY) / radius);
    moved();
  };
  pad.addEventListener("pointerdown", (event) => {
    pad.setPointerCapture(event.pointerId);
    drag(event);
  });
  pad.addEventListener("pointermove", (event) => dragged && drag(event));
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    pad.addEventListener(end, () => {
      dragged = null;
      moved();
    });
  }
}
