// Buttons, menus and keys.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];
const REACHES = [
  [0, "none"],
  [2, "2 s"],
  [5, "5 s"],
  [15, "15 s"],
  [1e9, "all"],
];
const LAYERS = [
  ["trails", "Trails"],
  ["crowd", "Drones without details"],
  ["rings", "d_safe circles"],
  ["stems", "Lines to ground and goal"],
  ["goals", "Goals"],
  ["contacts", "Contacts"],
  ["users", "Users"],
  ["links", "Links to served users"],
  ["beams", "Range finder beams"],
  ["cables", "Cables"],
  ["markers", "Markers of clients"],
  ["city", "City"],
];
const TRACKED = [1, 4, 16, 64]; // numbers of drones whose trails may be shown
const PAN = 40; // step of the view per key press, pixels

export const byId = (id) => document.getElementById(id);

/** Connect the page's controls to a `player`, once; see main.js. */
export function connect(player) {
  const speed = byId("speed");
  for (const one of SPEEDS) speed.add(new Option(`${one}×`, one, one === 1, one === 1));
  speed.addEventListener("change", () => player.setSpeed(Number(speed.value)));
  const reach = byId("reach");
  for (const [seconds, name] of REACHES)
    reach.add(new Option(name, seconds, seconds === 5, seconds === 5));
  reach.addEventListener("change", () => player.set("reach", Number(reach.value)));
  const tracked = byId("tracked");
  tracked.addEventListener("change", () => player.showTrails(Number(tracked.value)));
  const drone = byId("drone");
  drone.addEventListener("change", () => player.choose(Number(drone.value)));
  byId("true-size").addEventListener("change", (event) =>
    player.set("trueSize", event.target.checked),
  );
  byId("scrub").addEventListener("input", (event) => player.seek(Number(event.target.value)));
  for (const [id, act] of [
    ["play", () => player.toggle()],
    ["follow", () => player.follow(!player.following)],
    ["reset", () => player.whole()],
    ["theme", () => player.changeTheme()],
    ["plots", () => player.showPlots()],
    ["feed", () => player.goLive()],
  ])
    byId(id).addEventListener("click", act);
  document.addEventListener("keydown", (event) => press(event, player, speed));
  // A click elsewhere closes an open menu.
  document.addEventListener("pointerdown", (event) => {
    for (const menu of document.querySelectorAll("footer details[open]")) {
      if (!menu.contains(event.target)) menu.open = false;
    }
  });
}

/** Fill the controls for an episode: drones, layers, time range. */
export function fill(player) {
  const { about } = player.episode;
  const drones = about.detailed.map((one, k) => new Option(`drone_${one}`, k));
  byId("drone").replaceChildren(...drones);
  writeSampling(about);
  byId("scrub").min = player.episode.start;
  byId("scrub").max = player.episode.duration;
  byId("layers").querySelectorAll("label").forEach((label) => label.remove());
  for (const [name, text] of LAYERS) {
    if (!player.layers[name]) continue;
    const label = document.createElement("label");
    label.className = "row";
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = !player.hidden.has(name);
    box.id = `layer-${name}`;
    box.addEventListener("change", () => player.showLayer(name, box.checked));
    label.append(box, text);
    byId("layers").append(label);
  }
}

/** List how many drones may have trails, and write what a page of a large swarm contains. */
function writeSampling({ detailed, drones, every }) {
  const counts = [...TRACKED.filter((one) => one < detailed.length), detailed.length];
  byId("tracked").replaceChildren(...counts.map((one) => new Option(one, one)));
  byId("tracked").value = detailed.length;
  byId("all").textContent = `of ${drones} drones`;
  const sampling = byId("sampling");
  sampling.hidden = detailed.length === drones;
  const rows = every > 1 ? `, every ${every} decisions` : "";
  sampling.textContent =
    `${drones} drones by their positions${rows}; ` +
    `${detailed.length} of them also with attitudes, trails, goals and plots.`;
}

function press(event, player, speed) {
  const field =
    ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) &&
    event.target.type !== "checkbox";
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  // Fields and buttons handle their own keys.
  if (field && event.target.id !== "scrub") return;
  if (event.key === " " && ["BUTTON", "SUMMARY", "INPUT"].includes(event.target.tagName)) {
    if (event.target.id !== "scrub") return;
  }
  const jump = event.shiftKey ? 1 : player.episode.period;
  const keys = {
    " ": () => player.toggle(),
    arrowleft: () => player.seek(player.episode.time - jump),
    arrowright: () => player.seek(player.episode.time + jump),
    home: () => player.seek(player.episode.start),
    end: () => player.seek(player.episode.duration),
    "<": () => faster(speed, -1),
    ",": () => faster(speed, -1),
    ">": () => faster(speed, 1),
    ".": () => faster(speed, 1),
    n: () => player.choose(player.chosen + 1),
    p: () => player.choose(player.chosen - 1),
    f: () => player.follow(!player.following),
    r: () => player.whole(),
    t: () => player.changeTheme(),
    b: () => player.showPlots(),
    w: () => player.pan(0, PAN),
    s: () => player.pan(0, -PAN),
    a: () => player.pan(-PAN, 0),
    d: () => player.pan(PAN, 0),
    q: () => player.view.turn(-0.08, 0),
    e: () => player.view.turn(0.08, 0),
    "+": () => player.view.zoom(0.85),
    "=": () => player.view.zoom(0.85),
    "-": () => player.view.zoom(1 / 0.85),
  };
  const act = keys[event.key.toLowerCase()];
  if (!act) return;
  event.preventDefault();
  act();
}

function faster(speed, by) {
  speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
  speed.dispatchEvent(new Event("change"));
}
