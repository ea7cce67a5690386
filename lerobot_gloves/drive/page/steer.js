// Keys, gamepad, mouse and touch, as one stick: x to the right and y up, in [-1, 1], never longer than 1.

const KEYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  KeyA: [-1, 0], KeyD: [1, 0], KeyW: [0, 1], KeyS: [0, -1],
};
const DEAD = 0.15; // a gamepad's stick is never quite at its centre

const down = new Set();
let dragged = null;

function shortened(x, y) {
  const length = Math.hypot(x, y);
  return length > 1 ? [x / length, y / length] : [x, y];
}

function gamepad() {
  for (const pad of navigator.getGamepads ? navigator.getGamepads() : []) {
    if (!pad || !pad.connected) continue;
    const pressed = (i) => (pad.buttons[i] && pad.buttons[i].pressed ? 1 : 0);
    const x = pressed(15) - pressed(14), y = pressed(12) - pressed(13);
    if (x || y) return shortened(x, y);
    const [right = 0, below = 0] = pad.axes;
    if (Math.hypot(right, below) > DEAD) return shortened(right, -below);
  }
  return [0, 0];
}

export function position() {
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

export function install(pad, moved) {
  const release = () => {
    down.clear();
    dragged = null;
    moved();
  };
  addEventListener("keydown", (event) => {
    if (!(event.code in KEYS) || event.ctrlKey || event.altKey || event.metaKey || own(event.target, event.code)) return;
    event.preventDefault(); // the page would scroll
    if (!event.repeat) {
      down.add(event.code);
      moved();
    }
  });
  addEventListener("keyup", (event) => {
    if (down.delete(event.code)) moved();
  });
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
