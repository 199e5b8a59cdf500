// Builds the page from its payload, and renders a frame whenever something has changed.

import { Color, Scene, Vector3, WebGLRenderer } from "./three.module.min.js";
import { View } from "./camera.js";
import { byId, connect, fill } from "./controls.js";
import { Drones } from "./drones.js";
import { Episode } from "./episode.js";
import { setLineSize } from "./lines.js";
import { listen } from "./live.js";
import { Markers } from "./markers.js";
import { readPayload } from "./payload.js";
import { Plots } from "./plots.js";
import { Service } from "./service.js";
import { extent, World } from "./world.js";

const COLOURS = [
  "sky",
  "land",
  "grid",
  "building",
  "edge",
  "ring",
  "conflict",
  "goal",
  "seen",
  "unseen",
  "link",
  "cable",
  "beam",
  "miss",
  "contact",
  "glow",
];
const PICK = 24; // maximum distance of a click from a drone that it selects, pixels
const KEPT = 600; // number of frames whose times are kept
const SPARE = 0.15; // margin around a growing scene, as a fraction of its size
const PLOT_EVERY = 400; // interval between plots of a growing episode, ms

/** Player of episodes; `globalThis.replay` for consoles and tests. */
class Player {
  constructor(payload) {
    this.canvas = byId("view");
    // A page that embeds this one has the theme and the explanations.
    if (window.parent !== window) document.body.classList.add("compact");
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true });
    Object.assign(this, {
      chosen: 0,
      speed: 1,
      playing: false,
      atEnd: false, // whether to stay at the end of a growing episode
      following: false,
      loops: false, // whether to begin again at the end
      reach: 5,
      trueSize: false,
      hidden: new Set(), // names of layers
    });
    this.stats = { script: [], calls: 0, pictures: 0 }; // ms of scripts, draw calls, count
    this.spot = new Vector3();
    this.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    this.load(payload);
    connect(this);
    this.canvas.addEventListener("pointerdown", (event) => {
      this.pressed = [event.clientX, event.clientY];
    });
    this.canvas.addEventListener("click", (event) => this.pick(event));
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
    this.view.whole();
  }

  /** Show an episode instead of the previous one. */
  load(payload) {
    this.scene?.traverse((one) => {
      one.geometry?.dispose();
      one.material?.dispose();
    });
    this.episode = new Episode(payload);
    const { about } = this.episode;
    const whole = extent(this.episode);
    this.view ??= new View(this.canvas, whole);
    this.view.extent = whole;
    this.world = new World(this.episode, whole);
    this.drones = new Drones(this.episode);
    this.service = new Service(this.episode);
    this.markers = new Markers(this.episode);
    this.parts = [this.world, this.drones, this.service, this.markers];
    this.scene = new Scene();
    this.scene.add(...this.parts);
    const hasContacts = payload.grows || payload.array("contact_row").length;
    this.layers = {
      trails: this.drones.trails,
      crowd: this.episode.detailed < about.drones && this.drones.crowd,
      rings: this.drones.rings,
      stems: this.drones.stems,
      goals: about.goals && this.drones.goals,
      contacts: hasContacts && this.drones.contacts,
      users: about.users && this.service.users,
      links: this.service.hasLinks && this.service.links,
      beams: this.service.ranges && this.service.beams,
      cables: this.service.ends && this.service.cables,
      markers: this.markers.exists && this.markers,
      city: this.world.city,
    };
    for (const name of this.hidden) if (this.layers[name]) this.showLayer(name, false);
    this.plots = new Plots(this.episode, byId("charts"), (time) => this.seek(time));
    fill(this);
    this.setTheme(this.theme);
    this.choose(Math.min(this.chosen, this.episode.detailed - 1));
    document.title = document.querySelector("h1").textContent = about.title;
    if (payload.grows) this.goLive();
  }

  /** Show new rows of a growing episode. */
  grow() {
    const { episode, view } = this;
    episode.read();
    this.drones.trails.read();
    byId("scrub").max = episode.duration;
    const [low, high] = episode.bounds();
    const leaves = (one, axis) => one < view.extent.low[axis] || high[axis] > view.extent.high[axis];
    if (low.some(leaves)) {
      view.extent = extent(episode, SPARE);
      if (!view.touched) view.whole();
    }
    this.plotsAreOld = this.dirty = true;
  }

  /** Mark a growing episode as complete. */
  finish() {
    this.episode.payload.finish();
    this.episode.read();
    if (this.atEnd) this.toggle();
    this.dirty = true;
  }

  /** Go to the end of a growing episode, and stay there. */
  goLive() {
    this.atEnd = this.episode.payload.grows;
    if (!this.playing) this.toggle();
  }

  set(name, value) {
    this[name] = value;
    this.dirty = true;
  }

  setSpeed(speed) {
    this.speed = speed;
  }

  seek(time) {
    this.atEnd = this.episode.payload.grows && time >= this.episode.duration;
    this.episode.sample(time);
    this.dirty = true;
  }

  toggle() {
    const { episode } = this;
    this.playing = !this.playing;
    if (!this.playing) this.atEnd = false;
    else if (!this.atEnd && episode.time >= episode.duration) this.seek(episode.start);
    byId("play").textContent = this.playing ? "Pause" : "Play";
  }

  choose(drone) {
    const { detailed } = this.episode;
    this.chosen = (drone + detailed) % detailed;
    byId("drone").value = this.chosen;
    this.plots.draw(this.chosen);
    this.dirty = true;
  }

  follow(on) {
    this.following = on;
    byId("follow").setAttribute("aria-pressed", on);
    if (on) this.view.approach(this.drones.sizes[this.chosen]);
    this.dirty = true;
  }

  whole() {
    this.follow(false);
    this.view.whole();
  }

  pan(right, forward) {
    this.follow(false);
    this.view.move(right, forward);
  }

  /** Show the trails of the first `drones` drones. */
  showTrails(drones) {
    this.drones.trails.restrict(drones);
    this.dirty = true;
  }

  showLayer(name, on) {
    this.hidden[on ? "delete" : "add"](name);
    this.layers[name].visible = on;
    if (name === "city" && this.world.edges) this.world.edges.visible = on;
    this.dirty = true;
  }

  showPlots() {
    const plain = document.body.classList.toggle("plain");
    byId("plots").setAttribute("aria-pressed", !plain);
    this.resize();
  }

  changeTheme() {
    this.setTheme(this.theme === "dark" ? "light" : "dark");
  }

  setTheme(theme) {
    this.theme = theme;
    document.documentElement.dataset.theme = theme;
    const style = getComputedStyle(document.documentElement);
    const colours = COLOURS.map((name) => [
      name,
      new Color(style.getPropertyValue(`--${name}`).trim()),
    ]);
    const palette = Object.fromEntries(colours);
    this.scene.background = palette.sky;
    for (const part of this.parts) part.paint(palette);
    this.plots.draw();
    this.writeKey();
    this.dirty = true;
  }

  /** Write the legend of the visible colours. */
  writeKey() {
    const { layers } = this;
    const { d_safe: safe } = this.episode.about;
    const entries = [
      ["conflict", `separation below d_safe ${safe} m`, true],
      ["goal", "line to goal", layers.goals],
      ["seen", "target in sight", layers.users],
      ["unseen", "target out of sight", layers.users],
      ["link", "serves user", layers.links],
      ["beam", "range finder beam", layers.beams],
      ["cable", "cable", layers.cables],
      ["contact", "contact", layers.contacts],
    ].filter(([, , there]) => there);
    byId("key").replaceChildren(
      ...entries.map(([name, text]) => {
        const item = document.createElement("li");
        const chip = document.createElement("i");
        chip.style.background = `var(--${name})`;
        item.append(chip, text);
        return item;
      }),
    );
  }

  resize() {
    const [width, height] = [this.canvas.clientWidth || 1, this.canvas.clientHeight || 1];
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.size = [width, height];
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    setLineSize(width, height, ratio);
    // The panel is on the right, below in narrow windows, or hidden.
    const panel = byId("side").getBoundingClientRect();
    const isBelow = panel.width > 0.5 * width;
    const lower = isBelow ? panel : document.querySelector("footer").getBoundingClientRect();
    const right = isBelow || !panel.width ? 0 : width - panel.left;
    this.view.resize(width, height, right, height - lower.top);
    this.plots.draw();
    this.dirty = true;
  }

  /** Return the position of a drone on the canvas, pixels; null behind the camera. */
  project(drone) {
    return this.projectPoint(this.episode.position, 3 * drone);
  }

  /** Return the place of a position on the canvas, pixels; null behind the camera. */
  projectPoint(position, from = 0) {
    const at = this.spot.fromArray(position, from).project(this.view.camera);
    if (at.z > 1) return null;
    return [((1 + at.x) / 2) * this.size[0], ((1 - at.y) / 2) * this.size[1]];
  }

  pick(event) {
    // A drag is not a click.
    if (Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 4) return;
    let [best, nearest] = [-1, PICK];
    for (let k = 0; k < this.episode.detailed; k += 1) {
      const at = this.project(k);
      const away = at ? Math.hypot(at[0] - event.clientX, at[1] - event.clientY) : Infinity;
      if (away < nearest) [best, nearest] = [k, away];
    }
    if (best >= 0) this.choose(best);
  }

  /** Animation loop: advance the time, and draw if anything has changed. */
  turn(now) {
    const begin = performance.now();
    const seconds = Math.min(0.1, (now - (this.before ?? now)) / 1000);
    this.before = now;
    this.plotted ??= now;
    if (this.atEnd) this.approachEnd(seconds);
    else if (this.playing) {
      this.seek(this.episode.time + this.speed * seconds);
      if (this.episode.time >= this.episode.duration && !this.atEnd) {
        if (this.loops) this.seek(this.episode.start);
        else this.toggle();
      }
    }
    if (this.plotsAreOld && now - this.plotted > PLOT_EVERY) {
      [this.plotsAreOld, this.plotted] = [false, now];
      this.plots.draw();
    }
    if (this.dirty || this.view.changed) {
      this.draw(this.playing ? seconds : 0);
      this.stats.script.push(performance.now() - begin);
      this.stats.ready ??= performance.now();
      if (this.stats.script.length > KEPT) this.stats.script.shift();
    }
    requestAnimationFrame((later) => this.turn(later));
  }

  /** Stay about one decision behind the latest row, so that drones move smoothly. */
  approachEnd(seconds) {
    const { time, duration, period } = this.episode;
    const lag = duration - time;
    if (lag <= 0) return;
    this.episode.sample(time + lag * Math.min(1, seconds / period));
    this.dirty = true;
  }

  draw(seconds) {
    [this.dirty, this.view.changed] = [false, false];
    if (this.following) this.view.target.fromArray(this.episode.position, 3 * this.chosen);
    this.view.update();
    const eye = this.view.camera.position;
    const pixel = (x, y, z) => this.view.pixelAt(Math.hypot(x - eye.x, y - eye.y, z - eye.z));
    const { chosen, reach, trueSize } = this;
    const moment = { pixel, seconds, chosen, reach, trueSize };
    for (const part of this.parts) part.update(moment);
    this.renderer.render(this.scene, this.view.camera);
    this.stats.calls = this.renderer.info.render.calls;
    this.stats.pictures += 1;
    this.write();
  }

  /** Update texts and plots to the displayed time. */
  write() {
    const { episode, chosen } = this;
    byId("clock").textContent = `${episode.time.toFixed(1)} / ${episode.duration.toFixed(1)} s`;
    byId("scrub").value = episode.time;
    const [x, y, z] = episode.position.subarray(3 * chosen, 3 * chosen + 3);
    const now = !episode.flies(chosen)
      ? "finished"
      : episode.inConflict(chosen)
        ? "in conflict"
        : "flying";
    byId("state").textContent = `${now}, at ${x.toFixed(1)}, ${y.toFixed(1)}, ${z.toFixed(1)} m`;
    const at = this.project(chosen);
    byId("tag").hidden = !at;
    byId("tag").textContent = `drone_${chosen}`;
    if (at)
      byId("tag").style.transform =
        `translate(${(at[0] + 16).toFixed(0)}px, ${(at[1] - 26).toFixed(0)}px)`;
    this.markers.placeTexts((position) => this.projectPoint(position));
    this.plots.update();
  }
}

/**
 * Apply the options in the URL fragment: time, drone, theme, follow, play, loop, plots=off.
 *
 * A page that embeds this one can also set the theme later, by the message {theme: "dark"}.
 */
function applyFragment(player) {
  const options = new URLSearchParams(location.hash.slice(1));
  if (options.has("theme")) player.setTheme(options.get("theme") === "dark" ? "dark" : "light");
  if (options.has("drone")) player.choose(Number(options.get("drone")) || 0);
  if (options.has("time")) player.seek(Number(options.get("time")) || 0);
  if (options.has("follow")) player.follow(true);
  if (options.get("plots") === "off") player.showPlots();
  player.loops = options.has("loop");
  const stays = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (options.has("play") && !stays) player.toggle();
  addEventListener("message", ({ data }) => {
    if (data?.theme === "dark" || data?.theme === "light") player.setTheme(data.theme);
  });
}

/** Create the player of the first episode. */
function begin(payload) {
  const player = new Player(payload);
  applyFragment(player);
  globalThis.replay = player;
  requestAnimationFrame((now) => player.turn(now));
  return player;
}

function fail(error) {
  byId("trouble").hidden = false;
  byId("trouble").textContent = `This replay needs a browser with WebGL 2: ${error.message}`;
  console.error(error);
}

try {
  const text = byId("payload").textContent;
  if (text) begin(await readPayload(text));
  else listen(begin, fail);
} catch (error) {
  fail(error);
}
