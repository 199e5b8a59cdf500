// Plots of the selected drone, with a cursor at the displayed time.

const HEIGHT = 54; // of a plot, pixels
const GUTTER = 42; // space on the left for the minimum and maximum, pixels
const MOST_NAMES = 4; // maximum number of lines with their names and values above a plot
const OPEN = ["Flight", "Reward"];

function written(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 0.001 || size >= 1e7)) return value.toExponential(1);
  const text = value.toFixed(size < 10 ? 2 : size < 1000 ? 1 : 0);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

function element(tag, parent, text = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  parent.append(made);
  return made;
}

/** Return the colour of line k of several. */
function lineColour(k, count, ink) {
  return count === 1 ? ink : `hsl(${(210 + (360 * k) / count) % 360} 65% 52%)`;
}

class Plot {
  constructor(chart, episode, parent, seek) {
    this.chart = chart;
    this.episode = episode;
    this.lines = chart.lines.map((line) => ({
      ...line,
      values: episode.payload.series(line.series),
    }));
    const figure = element("figure", parent);
    const caption = element("figcaption", figure);
    element("b", caption, chart.unit ? `${chart.title} (${chart.unit})` : chart.title);
    const values = element("span", caption);
    const count = this.lines.length;
    this.values = this.lines
      .slice(0, count > MOST_NAMES ? 0 : count)
      .map(() => element("span", values));
    if (!this.values.length) values.textContent = `${count} lines`;
    this.canvas = element("canvas", figure);
    this.cursor = element("div", figure);
    this.cursor.className = "cursor";
    this.canvas.addEventListener("pointerdown", (event) => this.point(event, seek));
    this.canvas.addEventListener(
      "pointermove",
      (event) => event.buttons && this.point(event, seek),
    );
  }

  point(event, seek) {
    const box = this.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - GUTTER) / (box.width - GUTTER);
    const { start, duration } = this.episode;
    seek(start + (duration - start) * Math.min(1, Math.max(0, share)));
  }

  at(row, line, drone) {
    return line.values.at(row, drone * line.parts + line.part);
  }

  draw(drone, style) {
    const [width, ratio] = [this.canvas.clientWidth, window.devicePixelRatio || 1];
    if (!width) return;
    this.width = width;
    this.canvas.width = width * ratio;
    this.canvas.height = HEIGHT * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const { start, duration, about } = this.episode;
    const last = Math.min(this.episode.end[drone], about.rows - 1);
    const [low, high] = this.range(drone, last);
    const span = high - low || 1;
    const inner = width - GUTTER;
    const up = (value) => 3 + (HEIGHT - 6) * (1 - (value - low) / span);
    const along = inner / (duration - start);
    pen.strokeStyle = style.line;
    pen.strokeRect(GUTTER + 0.5, 0.5, inner - 1, HEIGHT - 1);
    if (this.chart.mark !== undefined && this.chart.mark <= high) {
      pen.strokeStyle = style.conflict;
      pen.setLineDash([4, 3]);
      pen.beginPath();
      pen.moveTo(GUTTER, up(this.chart.mark));
      pen.lineTo(width, up(this.chart.mark));
      pen.stroke();
      pen.setLineDash([]);
    }
    this.lines.forEach((line, k) => {
      pen.strokeStyle = lineColour(k, this.lines.length, style.accent);
      if (this.values[k] && this.lines.length > 1) this.values[k].style.color = pen.strokeStyle;
      pen.lineWidth = 1.3;
      pen.beginPath();
      let joined = false;
      for (let row = 0; row <= last; row += 1) {
        const value = this.at(row, line, drone);
        if (Number.isNaN(value)) joined = false;
        else {
          const across = GUTTER + along * (this.episode.times[row] - start);
          pen[joined ? "lineTo" : "moveTo"](across, up(value));
          joined = true;
        }
      }
      pen.stroke();
    });
    pen.fillStyle = style.faint;
    pen.font = "10px system-ui, sans-serif";
    pen.textAlign = "right";
    pen.fillText(written(high), GUTTER - 4, 10);
    pen.fillText(written(low), GUTTER - 4, HEIGHT - 2);
  }

  range(drone, last) {
    let [low, high] = [Infinity, -Infinity];
    for (const line of this.lines) {
      for (let row = 0; row <= last; row += 1) {
        const value = this.at(row, line, drone);
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    return low <= high ? [low, high] : [0, 1];
  }

  update(drone) {
    const { time, start, duration, decision, end } = this.episode;
    const along = GUTTER + ((this.width - GUTTER) * (time - start)) / (duration - start);
    this.cursor.style.transform = `translateX(${along.toFixed(1)}px)`;
    const row = Math.min(decision, end[drone]);
    this.values.forEach((place, k) => {
      const line = this.lines[k];
      const name = this.lines.length > 1 ? ` ${line.name.split(" ").pop()} ` : "";
      place.textContent = name + written(this.at(row, line, drone));
    });
  }
}

export class Plots {
  constructor(episode, parent, seek) {
    this.drone = 0;
    this.groups = new Map();
    // Groups that the user opened stay open in the next episode.
    const before = [...parent.children].map((one) => [one.dataset.name, one.open]);
    this.open = new Map([...OPEN.map((name) => [name, true]), ...before]);
    parent.replaceChildren();
    for (const chart of episode.about.charts) {
      if (!this.groups.has(chart.group)) this.addGroup(chart.group, parent);
      const { details, plots } = this.groups.get(chart.group);
      plots.push(new Plot(chart, episode, details, seek));
    }
  }

  addGroup(name, parent) {
    const details = element("details", parent);
    element("summary", details, name);
    details.dataset.name = name;
    details.open = this.open.get(name) ?? false;
    // Plots of a closed group have no size and are not drawn.
    details.addEventListener("toggle", () => this.draw());
    this.groups.set(name, { details, plots: [] });
  }

  shown() {
    return [...this.groups.values()]
      .filter(({ details }) => details.open)
      .flatMap(({ plots }) => plots);
  }

  draw(drone = this.drone) {
    this.drone = drone;
    const colours = getComputedStyle(document.documentElement);
    const names = ["line", "accent", "faint", "conflict"];
    const style = Object.fromEntries(
      names.map((name) => [name, colours.getPropertyValue(`--${name}`).trim()]),
    );
    for (const plot of this.shown()) plot.draw(drone, style);
    this.update();
  }

  update() {
    for (const plot of this.shown()) plot.update(this.drone);
  }
}
