// Lines some pixels wide, all of one kind in one draw call.

import {
  Color,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  BufferAttribute,
  DoubleSide,
  Mesh,
  ShaderMaterial,
  Vector2,
} from "./three.module.min.js";

const VERTEX = `
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
  // Ends behind the camera are moved to right before it.
  float near = 1e-3;
  if (a.w < near && b.w > near) a = mix(b, a, (b.w - near) / (b.w - a.w));
  if (b.w < near && a.w > near) b = mix(a, b, (a.w - near) / (a.w - b.w));
  vec2 way = (b.xy / b.w - a.xy / a.w) * size;
  float span = length(way);
  vec2 across = span > 0.0 ? vec2(-way.y, way.x) / span : vec2(0.0, 1.0);
  vec4 place = mix(a, b, position.x);
  place.xy += across * position.y * width / size * place.w;
  hue = tint;
  moment = mix(when.x, when.y, position.x);
  gl_Position = place;
}`;
/** The same for circles about `centre`, level, whose line has a width of its own. */
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
  .replace("position.y * width", "position.y * thick");
const SIDES = 48;
const FRAGMENT = `
uniform float now;
uniform float reach;
uniform float opacity;
varying vec3 hue;
varying float moment;
void main() {
  // Lines with a time fade as they age; the others have none.
  float age = now - moment;
  if (reach > 0.0 && (age < 0.0 || age > reach)) discard;
  gl_FragColor = vec4(hue, opacity * (reach > 0.0 ? 1.0 - 0.85 * age / reach : 1.0));
  #include <colorspace_fragment>
}`;
const CORNERS = new Float32Array([0, -1, 0, 1, -1, 0, 0, 1, 0, 1, 1, 0]);
const shared = { size: { value: new Vector2(1, 1) } };

/** Tell lines how large the picture is, pixels. */
export function setLineSize(width, height) {
  shared.size.value.set(width, height);
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

/** Up to `most` lines; `put` them from 0 on, then tell by `show` how many there are. */
export class Lines extends Mesh {
  constructor(most, width, opacity = 1) {
    const geometry = new InstancedBufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(CORNERS, 3));
    geometry.setIndex([0, 2, 1, 1, 2, 3]);
    for (const [name, parts] of [
      ["start", 3],
      ["finish", 3],
      ["tint", 3],
      ["when", 2],
    ]) {
      geometry.setAttribute(
        name,
        new InstancedBufferAttribute(new Float32Array(most * parts), parts),
      );
    }
    geometry.instanceCount = 0;
    super(geometry, lineMaterial(VERTEX, width, opacity));
    this.frustumCulled = false;
    this.parts = ["start", "finish", "tint", "when"].map((name) => geometry.attributes[name]);
  }

  put(k, from, fromAt, to, toAt, colour, whenFrom = 0, whenTo = 0) {
    const [start, finish, tint, when] = this.parts;
    start.setXYZ(k, from[fromAt], from[fromAt + 1], from[fromAt + 2]);
    finish.setXYZ(k, to[toAt], to[toAt + 1], to[toAt + 2]);
    tint.setXYZ(k, colour.r, colour.g, colour.b);
    when.setXY(k, whenFrom, whenTo);
  }

  show(count) {
    this.geometry.instanceCount = count;
    for (const part of this.parts) part.needsUpdate = true;
  }
}

/** Circles about drones, level. */
export class Rings extends Mesh {
  constructor(count, radius) {
    const geometry = new InstancedBufferGeometry();
    const [position, arc, index] = [[], [], []];
    for (let k = 0; k < SIDES; k += 1) {
      position.push(...CORNERS);
      const ends = [(2 * Math.PI * k) / SIDES, (2 * Math.PI * (k + 1)) / SIDES];
      for (let corner = 0; corner < 4; corner += 1) arc.push(...ends);
      index.push(...[0, 2, 1, 1, 2, 3].map((corner) => 4 * k + corner));
    }
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(position), 3));
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

/** Trails of all drones: pieces of some rows each, of which those in reach are drawn. */
export class Trails {
  constructor(episode, group) {
    const { rows, drones, colours } = episode.about;
    const hues = colours.map((one) => new Color(one));
    const position = episode.payload.series("position");
    const pieces = 24;
    const each = Math.max(1, Math.ceil((rows - 1) / pieces));
    this.pieces = [];
    const from = new Float32Array(3 * drones);
    const to = new Float32Array(3 * drones);
    for (let first = 0; first + 1 < rows; first += each) {
      const last = Math.min(first + each, rows - 1);
      const lines = new Lines((last - first) * drones, 2);
      let count = 0;
      for (let row = first; row < last; row += 1) {
        position.between(row, 0, from);
        position.between(row + 1, 0, to);
        for (let k = 0; k < drones; k += 1) {
          if (row >= episode.end[k]) continue;
          lines.put(
            count,
            from,
            3 * k,
            to,
            3 * k,
            hues[k],
            episode.times[row],
            episode.times[row + 1],
          );
          count += 1;
        }
      }
      lines.show(count);
      group.add(lines);
      this.pieces.push({ lines, begins: episode.times[first], ends: episode.times[last] });
    }
  }

  /** Show what was flown in the last `reach` seconds. */
  update(now, reach) {
    for (const { lines, begins, ends } of this.pieces) {
      lines.visible = reach > 0 && begins <= now && ends >= now - reach;
      lines.material.uniforms.now.value = now;
      lines.material.uniforms.reach.value = reach;
    }
  }
}
