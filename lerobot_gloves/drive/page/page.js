// The connection, and what goes between it and the page.

import * as draw from "./draw.js";
import * as steer from "./steer.js";
import * as study from "./study.js";

const EVERY = 50; // milliseconds between two commands; the robot stops after 300 without one
const FINAL = { 1008: true, 1013: true, 4000: true }; // codes of a closed connection after which trying again is no use
const at = (id) => document.getElementById(id);

const id = (sessionStorage.page ||= [...crypto.getRandomValues(new Uint32Array(4))].join("-"));
let socket = null, wait = 500, lost = "";
let scene = null, about = null, state = null, trail = [], states = [];
let role = { drives: false, free: false };

function connect() {
  const query = new URLSearchParams(location.search);
  query.set("page", id);
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket?${query}`);
  socket.binaryType = "blob";
  socket.onopen = () => { wait = 500; };
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : show(data));
  socket.onclose = ({ code, reason }) => {
    role = { drives: false, free: false };
    lost = FINAL[code] ? `Closed: ${reason || "not allowed"}. Reload to try again.`
      : "Connection lost, the robot stands still. Reconnecting …";
    tellRole();
    if (!FINAL[code]) setTimeout(connect, wait);
    wait = Math.min(2 * wait, 4000);
  };
}

function say(message) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function show(blob) {
  const old = at("camera").src;
  at("camera").src = URL.createObjectURL(blob);
  if (old) URL.revokeObjectURL(old);
}

function hear(message) {
  if (message.type === "scene") {
    scene = message;
    states = [];
    lost = "";
    at("fault").replaceChildren(...scene.faults.map((name) => new Option(name, name)));
    for (const name of ["height", "grip"]) at(name).hidden = !scene.keys.includes(name);
    steer.begin(scene.keys);
    tellFingers(false);
    at("ungated").textContent = scene.ungated && `No gate: ${scene.ungated}.`;
  } else if (message.type === "role") {
    role = message;
    tellRole();
  } else if (message.type === "trail") {
    trail = message.trail;
    state = null; // up to date with the trail
  } else if (message.type === "about") {
    about = message;
    at("words").textContent = about.words;
    study.tell(about.study);
    tellSettings();
  } else if (message.type === "error") {
    at("notice").textContent = message.line;
  } else if (message.type === "state") {
    step(message);
  }
}

function step(next) {
  if (state && next.episode !== state.episode) {
    trail = [];
    tellFingers(steer.grip(false));
  }
  if (state && (next.step !== state.step || next.episode !== state.episode)) trail.push([...next.place, next.edited]);
  state = next;
  states.push(state);
  if (states.length > 2 * draw.KEPT_SECONDS * scene.rate) states = states.slice(-draw.KEPT_SECONDS * scene.rate);
  const outcome = {
    ready: studied() ? "" : "Ready: the episode begins with your first command.", driving: "",
    success: `Success!${onward(false)}`, failure: `${state.ending}${onward(true)}`,
  }[state.phase];
  if (at("outcome").textContent !== outcome) at("outcome").textContent = outcome;
  at("outcome").className = state.phase;
  if (state.notice) at("notice").textContent = state.notice;
  const { p } = state;
  const judged = p === null ? "not judged" : p < 0.001 ? "p < 0.001" : `p = ${p.toFixed(3)}`;
  const still = !state.sent[0] && !state.sent[1] && !state.sent[2];
  at("reading").textContent = state.phase !== "driving" ? "Nothing is executed." : still ? "Standing still."
    : `${state.edited ? "Edited" : "Executed as sent"}, ${judged}.`;
  paint();
}

// Whether a study is over.
function studied() {
  return Boolean(about && about.study && about.study.results);
}

function onward(again) {
  if (studied()) return "";
  return again && !(about && about.study) ? " Press R to try again." : " Press N for the next one.";
}

function paint() {
  if (!scene || !about || !state) return;
  draw.top(at("top"), scene, about, trail, state);
  if (!about.study) draw.strip(at("strip"), states, about.settings, scene.rate);
}

function tellRole() {
  const text = lost || (role.drives ? "You drive." : role.free ? "You watch; nobody drives." : "You watch; another page drives.");
  if (at("role").textContent !== text) at("role").textContent = text;
  at("take").hidden = !role.free || role.drives;
  for (const one of [...at("settings").elements, at("again"), at("next"), at("up"), at("down"), at("fingers")]) one.disabled = !role.drives;
  tellSettings();
}

function tellSettings() {
  if (!about || !scene || about.study) return;
  const { assistance, alpha, limit, fault } = about.settings;
  const drives = role.drives;
  for (const one of document.getElementsByName("assistance")) {
    one.checked = one.value === assistance;
    one.disabled = !drives || (one.value !== "off" && !scene.adapter) || (one.value === "gate" && Boolean(scene.ungated));
  }
  // What is being dragged is not pulled back by an answer that is late.
  if (document.activeElement !== at("alpha")) at("alpha").value = Math.log10(alpha);
  if (document.activeElement !== at("limit")) at("limit").value = limit;
  at("fault").value = fault;
  at("alphaOut").textContent = alpha.toFixed(3);
  at("limitOut").textContent = limit >= 2 ? "any" : limit.toFixed(2);
}

function choose() {
  at("notice").textContent = "";
  const chosen = [...document.getElementsByName("assistance")].find((one) => one.checked);
  say({
    type: "settings", assistance: chosen ? chosen.value : "off", alpha: Number((10 ** at("alpha").value).toFixed(4)),
    limit: Number(at("limit").value), fault: at("fault").value,
  });
}

function tellFingers(closed) {
  at("fingers").textContent = closed ? "Open fingers (G)" : "Close fingers (G)";
  at("fingers").setAttribute("aria-pressed", closed);
}

function fingers() {
  if (role.drives && scene.keys.includes("grip")) steer.grip();
  command();
}

function command() {
  const stick = steer.stick();
  const { x, y, z } = stick;
  tellFingers(stick.grip > 0);
  const radius = at("pad").clientWidth / 2 - 28;
  at("knob").style.transform = `translate(${x * radius}px, ${-y * radius}px)`;
  at("pad").classList.toggle("still", !x && !y && !z);
  if (role.drives) say({ type: "command", ...stick });
}

function begin(episode) {
  at("notice").textContent = "";
  if (role.drives) say({ type: "begin", episode });
}

steer.install(at("pad"), [[at("up"), 1], [at("down"), -1]], command);
setInterval(command, EVERY);
at("settings").addEventListener("input", choose);
at("settings").addEventListener("submit", (event) => event.preventDefault());
at("take").addEventListener("click", () => say({ type: "take" }));
at("again").addEventListener("click", () => begin("again"));
at("next").addEventListener("click", () => begin("next"));
at("fingers").addEventListener("click", fingers);
addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
  if (event.code === "KeyR") begin("again");
  if (event.code === "KeyN") begin("next");
  if (event.code === "KeyG") fingers();
});
// Who has set something by mouse or touch goes on steering by keys, which a slider would take for itself.
let pointer = false;
addEventListener("pointerdown", () => { pointer = true; }, true);
addEventListener("keydown", () => { pointer = false; }, true);
for (const [event, kind] of [["click", "input"], ["change", "select"]]) {
  at("settings").addEventListener(event, ({ target }) => {
    if (pointer && target.matches(kind)) at("pad").focus({ preventScroll: true });
  });
}
new ResizeObserver(paint).observe(at("top"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
tellRole();
connect();
