// Lines with a width in pixels, drawn in one call for each kind.

import {
  Color,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Mesh,
  Points,
  ShaderMaterial,
  Vector2,
} from "./three.module.min.js";

const VERTEX = `
attribute vec2 corner;
attribute vec3 start;
attribute vec3 finish;
attribute vec3 tint;
attribute vec2 when;
uniform vec2 size;
uniform float width;
varying vec3 hue;
varying float moment;
void main() {
  vec4 a = projectionMatrix * viewMatrix * vec4(start, 1.0);
  vec4 b = projectionMatrix * viewMatrix * vec4(finish, 1.0);
  // Clip lines at the near plane.
  float near = 1e-3;
  if (a.w < near && b.w > near) a = mix(b, a, (b.w - near) / (b.w - a.w));
  if (b.w < near && a.w > near) b = mix(a, b, (a.w - near) / (a.w - b.w));
  vec2 way = (b.xy / b.w - a.xy / a.w) * size;
  float span = length(way);
  vec2 across = span > 0.0 ? vec2(-way.y, way.x) / span : vec2(0.0, 1.0);
  vec4 place = mix(a, b, corner.x);
  place.xy += across * corner.y * width / size * place.w;
  hue = tint;
  moment = mix(when.x, when.y, corner.x);
  gl_Position = place;
}`;
/** The same for horizontal circles about `centre`, each with its own line width. */
const RING = VERTEX.replace(
  "attribute vec3 start;\nattribute vec3 finish;",
  "attribute vec3 centre;\nattribute vec2 arc;\nattribute float thick;\nuniform float radius;",
)
  .replace(
    "void main() {",
    `void main() {
  vec3 start = centre + radius * vec3(cos(arc.x), sin(arc.x), 0.0);
  vec3 finish = centre + radius * vec3(cos(arc.y), sin(arc.y), 0.0);`,
  )
  .replace("corner.y * width", "corner.y * thick");
const SIDES = 48;
const FRAGMENT = `
uniform float now;
uniform float reach;
uniform float opacity;
varying vec3 hue;
varying float moment;
void main() {
  // Lines with a time stamp fade with age; others do not.
  float age = now - moment;
  if (reach > 0.0 && (age < 0.0 || age > reach)) discard;
  gl_FragColor = vec4(hue, opacity * (reach > 0.0 ? 1.0 - 0.85 * age / reach : 1.0));
  #include <colorspace_fragment>
}`;
const CORNERS = [0, -1, 1, -1, 0, 1, 1, 1]; // of a line: coordinate along and across
const TRIANGLES = [0, 2, 1, 1, 2, 3];
const PARTS = ["start", "finish", "tint", "when"]; // attributes of a line
const shared = { size: { value: new Vector2(1, 1) }, ratio: { value: 1 } };

/** Set the size of the canvas for all lines and points, pixels, and device pixels per pixel. */
export function setLineSize(width, height, ratio) {
  shared.size.value.set(width, height);
  shared.ratio.value = ratio;
}

function lineMaterial(vertexShader, width, opacity, more = {}) {
  const uniforms = {
    size: shared.size,
    width: { value: width },
    opacity: { value: opacity },
    now: { value: 0 },
    reach: { value: 0 },
    ...more,
  };
  return new ShaderMaterial({
    uniforms,
    vertexShader,
    fragmentShader: FRAGMENT,
    transparent: true,
    depthWrite: false,
    side: DoubleSide,
  });
}

function lineGeometry(most) {
  const geometry = new BufferGeometry();
  const corner = new Float32Array(8 * most);
  const index = new Uint32Array(6 * most);
  for (let k = 0; k < most; k += 1) {
    corner.set(CORNERS, 8 * k);
    for (let part = 0; part < 6; part += 1) index[6 * k + part] = 4 * k + TRIANGLES[part];
  }
  geometry.setIndex(new BufferAttribute(index, 1));
  geometry.setAttribute("corner", new BufferAttribute(corner, 2));
  geometry.setAttribute("start", new BufferAttribute(new Float32Array(12 * most), 3));
  geometry.setAttribute("finish", new BufferAttribute(new Float32Array(12 * most), 3));
  geometry.setAttribute("tint", new BufferAttribute(new Uint8Array(16 * most), 4, true));
  geometry.setAttribute("when", new BufferAttribute(new Float32Array(8 * most), 2));
  return geometry;
}

/**
 * Up to `most` lines: set them by `put`, from 0 on, then draw their number by `show`.
 *
 * Each line has its own four vertices: small instances are slow with software rendering.
 */
export class Lines extends Mesh {
  constructor(most, width, opacity = 1) {
    super(lineGeometry(most), lineMaterial(VERTEX, width, opacity));
    this.frustumCulled = false;
    this.most = most;
    this.parts = PARTS.map((name) => this.geometry.attributes[name]);
  }

  /** Increase the capacity; existing lines are kept. */
  grow(most) {
    const geometry = lineGeometry(most);
    const parts = PARTS.map((name) => geometry.attributes[name]);
    parts.forEach((part, k) => part.array.set(this.parts[k].array));
    this.geometry.dispose();
    [this.geometry, this.parts, this.most] = [geometry, parts, most];
  }

  put(k, from, fromAt, to, toAt, colour, whenFrom = 0, whenTo = 0) {
    const [start, finish, tint, when] = this.parts;
    for (let v = 4 * k; v < 4 * k + 4; v += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        start.array[3 * v + axis] = from[fromAt + axis];
        finish.array[3 * v + axis] = to[toAt + axis];
      }
      tint.setXYZ(v, colour.r, colour.g, colour.b);
      when.array[2 * v] = whenFrom;
      when.array[2 * v + 1] = whenTo;
    }
  }

  /** Draw `count` lines, of which those from `first` on have changed. */
  show(count, first = 0) {
    this.geometry.setDrawRange(0, 6 * count);
    for (const part of this.parts) {
      if (!first) part.clearUpdateRanges();
      part.addUpdateRange(4 * first * part.itemSize, 4 * (count - first) * part.itemSize);
      part.needsUpdate = count > first;
    }
  }
}

/** Horizontal circles about drones. */
export class Rings extends Mesh {
  constructor(count, radius) {
    const geometry = new InstancedBufferGeometry();
    const [corners, arc, index] = [[], [], []];
    for (let k = 0; k < SIDES; k += 1) {
      corners.push(...CORNERS);
      const ends = [(2 * Math.PI * k) / SIDES, (2 * Math.PI * (k + 1)) / SIDES];
      for (let corner = 0; corner < 4; corner += 1) arc.push(...ends);
      index.push(...TRIANGLES.map((corner) => 4 * k + corner));
    }
    geometry.setAttribute("corner", new BufferAttribute(new Float32Array(corners), 2));
    geometry.setAttribute("arc", new BufferAttribute(new Float32Array(arc), 2));
    geometry.setIndex(index);
    for (const [name, parts] of [
      ["centre", 3],
      ["tint", 3],
      ["thick", 1],
    ]) {
      geometry.setAttribute(
        name,
        new InstancedBufferAttribute(new Float32Array(count * parts), parts),
      );
    }
    super(geometry, lineMaterial(RING, 1, 0.9, { radius: { value: radius } }));
    this.frustumCulled = false;
    this.parts = ["centre", "tint", "thick"].map((name) => geometry.attributes[name]);
  }

  put(k, places, colour, thick) {
    const [centre, tint, width] = this.parts;
    centre.setXYZ(k, places[3 * k], places[3 * k + 1], places[3 * k + 2]);
    tint.setXYZ(k, colour.r, colour.g, colour.b);
    width.setX(k, thick);
  }

  show(count) {
    this.geometry.instanceCount = count;
    for (const part of this.parts) part.needsUpdate = true;
  }
}

const POINT_VERTEX = `
attribute vec4 tint;
uniform vec2 size;
uniform float ratio;
uniform float least;
uniform float diameter;
varying vec3 hue;
void main() {
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
  float seen = 0.5 * diameter * projectionMatrix[1][1] * size.y / gl_Position.w;
  hue = tint.rgb;
  // The fourth component is a factor of the size, of which 1 is 1 / 2.
  gl_PointSize = 2.0 * tint.a * ratio * max(least, seen);
}`;
const POINT_FRAGMENT = `
varying vec3 hue;
void main() {
  if (length(gl_PointCoord - 0.5) > 0.5) discard;
  gl_FragColor = vec4(hue, 1.0);
  #include <colorspace_fragment>
}`;

/** Discs of a diameter in m at positions that the caller changes, at least `least` pixels wide. */
export class Discs extends Points {
  constructor(places, first, diameter, least) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(places, 3));
    const tint = new BufferAttribute(new Uint8Array((4 * places.length) / 3), 4, true);
    geometry.setAttribute("tint", tint);
    geometry.setDrawRange(first, places.length / 3 - first);
    const uniforms = { ...shared, least: { value: least }, diameter: { value: diameter } };
    const shaders = { vertexShader: POINT_VERTEX, fragmentShader: POINT_FRAGMENT };
    super(geometry, new ShaderMaterial({ uniforms, ...shaders }));
    this.frustumCulled = false;
    this.tint = tint;
  }

  /** Set colour and size, as a factor up to 2, of a disc. */
  put(k, colour, factor) {
    this.tint.setXYZW(k, colour.r, colour.g, colour.b, 0.5 * factor);
  }

  /** Draw the discs at their present positions. */
  show() {
    this.tint.needsUpdate = true;
    this.geometry.attributes.position.needsUpdate = true;
  }
}

/** Trails of drones: segments in chronological order, of which the recent ones are drawn. */
export class Trails extends Lines {
  constructor(episode) {
    const { rows, colours } = episode.about;
    super(Math.max(1, (rows - 1) * episode.detailed), 2);
    this.episode = episode;
    this.drones = episode.detailed;
    this.hues = colours.map((one) => new Color(one));
    // The segments of row k start at `begins[k]`.
    this.begins = [];
    this.total = 0;
    this.read();
  }

  /** Show the trails of the first `drones` drones only. */
  restrict(drones) {
    [this.drones, this.begins, this.total] = [drones, [], 0];
    this.read();
  }

  /** Add the segments of new rows. */
  read() {
    const { about, payload, times, end } = this.episode;
    const position = payload.series("position");
    const [from, to] = [new Float32Array(3 * about.drones), new Float32Array(3 * about.drones)];
    let first = this.total;
    for (let row = this.begins.length; row + 1 < about.rows; row += 1) {
      this.begins.push(this.total);
      if (this.total + this.drones > this.most) {
        this.grow(2 * (this.total + this.drones));
        first = 0;
      }
      position.between(row, 0, from);
      position.between(row + 1, 0, to);
      for (let k = 0; k < this.drones; k += 1) {
        if (row >= end[k]) continue;
        this.put(this.total, from, 3 * k, to, 3 * k, this.hues[k], times[row], times[row + 1]);
        this.total += 1;
      }
    }
    this.show(this.total, first);
  }

  /** Show the last `reach` seconds. */
  update(reach) {
    const { time, start, row, period } = this.episode;
    const before = (one) => this.begins[one] ?? this.total;
    const first = before(Math.max(0, Math.floor((time - start - reach) / period)));
    const count = reach > 0 ? before(row + 1) - first : 0;
    this.geometry.setDrawRange(6 * first, 6 * count);
    this.material.uniforms.now.value = time;
    this.material.uniforms.reach.value = reach;
  }
}
