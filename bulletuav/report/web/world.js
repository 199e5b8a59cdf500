// Static scene: ground, city, obstacles, light.

import {
  BatchedMesh,
  BufferAttribute,
  BufferGeometry,
  CircleGeometry,
  Color,
  DirectionalLight,
  DoubleSide,
  EdgesGeometry,
  Group,
  HemisphereLight,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  ShaderMaterial,
} from "./three.module.min.js";
import { hue, joined, shapeGeometry, writePose } from "./shapes.js";

const REACH = 25; // radius of the ground, in sizes of the scene
const GROUND_VERTEX = `
varying vec2 place;
varying vec2 aside;
void main() {
  place = (modelMatrix * vec4(position, 1.0)).xy;
  aside = position.xy;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const GROUND_FRAGMENT = `
uniform vec3 land, grid, sky;
uniform float pitch, reach;
varying vec2 place;
varying vec2 aside;
// Coverage of a pixel by a grid line; far lines fade out, to avoid aliasing.
float lines(float apart) {
  vec2 at = place / apart;
  vec2 size = fwidth(at);
  vec2 near = abs(fract(at - 0.5) - 0.5) / size;
  vec2 share = (1.0 - min(near, 1.0)) * clamp(0.35 / size - 0.4, 0.0, 1.0);
  return max(share.x, share.y);
}
void main() {
  vec3 colour = mix(land, grid, max(lines(pitch), 0.3 * lines(0.2 * pitch)));
  gl_FragColor = vec4(mix(colour, sky, smoothstep(0.1, 0.95, length(aside) / reach)), 1.0);
  #include <colorspace_fragment>
}`;
const PAD = 0x1a8cbf; // colour of charging pads
const PAD_HEIGHT = 0.05; // height at which they are drawn, m
const MOST_EDGES = 200000; // maximum number of a city's triangles up to which its edges are drawn

/** Return the bounding box of the scene with a margin, its centre and its size. */
export function extent(episode, margin = 0) {
  const [low, high] = episode.bounds();
  const corners = episode.payload.array("city_corners");
  for (let k = 0; k < corners.length; k += 1) {
    low[k % 3] = Math.min(low[k % 3], corners[k]);
    high[k % 3] = Math.max(high[k % 3], corners[k]);
  }
  // The d_safe circles extend beyond the positions of drones.
  for (const axis of [0, 1, 2]) {
    const more = (axis < 2 ? 0.5 * episode.about.d_safe : 0) + margin * (high[axis] - low[axis]);
    low[axis] -= axis < 2 ? more : 0;
    high[axis] += more;
  }
  const middle = low.map((least, axis) => (least + high[axis]) / 2);
  const size = Math.max(1, Math.hypot(...low.map((least, axis) => high[axis] - least)));
  return { low, high, middle, size };
}

/** Round a length to the nearest of 1, 2, 5, 10, 20, ... m. */
function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return (
    power *
    [1, 2, 5, 10].reduce((best, one) =>
      Math.abs(one - length / power) < Math.abs(best - length / power) ? one : best,
    )
  );
}

export class World extends Group {
  constructor(episode, { middle, size }) {
    super();
    this.episode = episode;
    this.sun = new DirectionalLight(0xffffff, 1.9);
    this.sun.position.set(-0.5, -0.8, 1.4);
    this.light = new HemisphereLight(0xffffff, 0x8a8f88, 1.7);
    this.add(this.sun, this.light);
    this.addGround(middle, size);
    this.addCity();
    this.addObstacles();
    this.addPads();
  }

  addGround(middle, size) {
    this.ground = new Mesh(
      new CircleGeometry(REACH * size, 64),
      new ShaderMaterial({
        uniforms: {
          land: { value: new Color() },
          grid: { value: new Color() },
          sky: { value: new Color() },
          pitch: { value: roundLength(size / 12) },
          reach: { value: REACH * size },
        },
        vertexShader: GROUND_VERTEX,
        fragmentShader: GROUND_FRAGMENT,
        depthWrite: false,
      }),
    );
    // Drawn first and without depth, as nothing is below the ground.
    this.ground.renderOrder = -1;
    this.ground.position.set(middle[0], middle[1], 0);
    this.add(this.ground);
  }

  addCity() {
    const { payload } = this.episode;
    const corners = payload.array("city_corners");
    if (!corners.length) return;
    const whole = new BufferGeometry();
    whole.setAttribute("position", new BufferAttribute(corners, 3));
    whole.setIndex(new BufferAttribute(payload.array("city_triangles"), 1));
    const flat = whole.toNonIndexed();
    flat.computeVertexNormals();
    // Walls are darker near the ground, to make heights visible.
    const place = flat.attributes.position;
    const shade = new Float32Array(3 * place.count);
    const own = payload.array("city_colours");
    this.hasOwnColours = own.length > 0;
    const triangles = payload.array("city_triangles");
    for (let k = 0; k < place.count; k += 1) {
      const bright = 0.72 + 0.28 * Math.min(1, place.getZ(k) / 30);
      shade.fill(bright, 3 * k, 3 * k + 3);
      if (this.hasOwnColours) {
        const corner = 3 * triangles[k];
        hue(own.subarray(corner, corner + 3)).toArray(shade, 3 * k);
      }
    }
    flat.setAttribute("color", new BufferAttribute(shade, 3));
    this.city = new Mesh(
      flat,
      new MeshLambertMaterial({
        vertexColors: true,
        polygonOffset: true,
        polygonOffsetFactor: 1,
        polygonOffsetUnits: 1,
      }),
    );
    this.add(this.city);
    if (place.count < 3 * MOST_EDGES) {
      this.edges = new LineSegments(
        new EdgesGeometry(whole, 20),
        new LineBasicMaterial({ transparent: true, opacity: 0.55 }),
      );
      this.add(this.edges);
    }
  }

  addObstacles() {
    const { obstacles } = this.episode.about;
    if (!obstacles.length) return;
    const known = new Map();
    for (const one of obstacles) {
      const key = JSON.stringify([one.kind, one.half, one.corners]);
      one.key = key;
      const white = {
        geometry: shapeGeometry(one),
        matrix: new Matrix4(),
        hue: new Color(1, 1, 1),
      };
      if (!known.has(key)) known.set(key, joined([white]));
    }
    const corners = [...known.values()].reduce(
      (sum, one) => sum + one.attributes.position.count,
      0,
    );
    const material = new MeshLambertMaterial({ side: DoubleSide });
    this.bodies = new BatchedMesh(obstacles.length, corners, 1, material);
    this.bodies.perObjectFrustumCulled = false;
    this.bodies.sortObjects = false;
    this.bodies.frustumCulled = false;
    const shapes = new Map([...known].map(([key, one]) => [key, this.bodies.addGeometry(one)]));
    for (const one of obstacles) {
      const id = this.bodies.addInstance(shapes.get(one.key));
      this.bodies.setColorAt(id, hue(one.colour));
    }
    const steps = ["obstacle", "obstacle_quaternion"].map(
      (name) => this.episode.payload.series(name).step,
    );
    this.obstaclesMove = this.episode.payload.grows || steps.some((step) => step.some((one) => one > 0));
    this.matrix4 = new Matrix4();
    this.placeObstacles();
    this.add(this.bodies);
  }

  /** Add the zones of charging pads, slightly above the ground. */
  addPads() {
    const { places, radius } = this.episode.about.pads;
    const material = new MeshLambertMaterial({ color: PAD });
    for (const [x, y, z] of places) {
      const pad = new Mesh(new CircleGeometry(radius, 32), material);
      pad.position.set(x, y, z + PAD_HEIGHT);
      this.add(pad);
    }
  }

  placeObstacles() {
    const { obstacle, obstacle_quaternion: turn, about } = this.episode;
    for (let k = 0; k < about.obstacles.length; k += 1) {
      const [p, q] = [3 * k, 4 * k];
      writePose(
        this.matrix4.elements,
        0,
        obstacle[p],
        obstacle[p + 1],
        obstacle[p + 2],
        turn[q],
        turn[q + 1],
        turn[q + 2],
        turn[q + 3],
        1,
      );
      this.bodies.setMatrixAt(k, this.matrix4);
    }
  }

  update() {
    if (this.obstaclesMove) this.placeObstacles();
  }

  paint(palette) {
    for (const name of ["land", "grid", "sky"])
      this.ground.material.uniforms[name].value = palette[name];
    if (this.city && !this.hasOwnColours) this.city.material.color = palette.building;
    if (this.edges) this.edges.material.color = palette.edge;
  }
}
