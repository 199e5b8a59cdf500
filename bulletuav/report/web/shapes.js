// Geometries of the package's shapes, and merging of geometries.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  Color,
  CylinderGeometry,
  Matrix4,
  Quaternion,
  SphereGeometry,
  Vector3,
} from "./three.module.min.js";

const [SPHERE, CYLINDER, BOX] = [0, 1, 2]; // kinds in geometry/shapes.py

/** Return the geometry of a shape about its own origin. */
export function shapeGeometry({ kind, half, corners, triangles }) {
  if (kind === SPHERE) return new SphereGeometry(half[0], 20, 14);
  if (kind === CYLINDER)
    return new CylinderGeometry(half[0], half[0], 2 * half[2], 24).rotateX(Math.PI / 2);
  if (kind === BOX) return new BoxGeometry(2 * half[0], 2 * half[1], 2 * half[2]);
  const hull = new BufferGeometry();
  hull.setAttribute("position", new BufferAttribute(new Float32Array(corners.flat()), 3));
  hull.setIndex(triangles.flat());
  const flat = hull.toNonIndexed();
  flat.computeVertexNormals();
  return flat;
}

/** Merge geometries, each with its pose and colour, to one with vertex colours. */
export function joined(parts) {
  const position = [];
  const normal = [];
  const colour = [];
  for (const { geometry, matrix, hue } of parts) {
    const flat = geometry.index ? geometry.toNonIndexed() : geometry;
    flat.applyMatrix4(matrix);
    position.push(...flat.attributes.position.array);
    normal.push(...flat.attributes.normal.array);
    for (let k = 0; k < flat.attributes.position.count; k += 1) colour.push(hue.r, hue.g, hue.b);
  }
  const whole = new BufferGeometry();
  for (const [name, values] of [
    ["position", position],
    ["normal", normal],
    ["color", colour],
  ]) {
    whole.setAttribute(name, new BufferAttribute(new Float32Array(values), 3));
  }
  return whole;
}

/** Return the matrix of a position, a quaternion and a scale. */
export function pose(position, quaternion = [0, 0, 0, 1], scale = [1, 1, 1]) {
  return new Matrix4().compose(
    new Vector3(...position),
    new Quaternion(...quaternion),
    new Vector3(...scale),
  );
}

/** Return the colour of sRGB components [red, green, blue]. */
export function hue([red, green, blue]) {
  return new Color().setRGB(red, green, blue, "srgb");
}

/** Write the matrix of a pose and a scale into `out` from `at` on, without allocations. */
export function writePose(out, at, x, y, z, qx, qy, qz, qw, scale) {
  const [xx, yy, zz] = [2 * qx * qx, 2 * qy * qy, 2 * qz * qz];
  const [xy, xz, yz] = [2 * qx * qy, 2 * qx * qz, 2 * qy * qz];
  const [wx, wy, wz] = [2 * qw * qx, 2 * qw * qy, 2 * qw * qz];
  out[at] = (1 - yy - zz) * scale;
  out[at + 1] = (xy + wz) * scale;
  out[at + 2] = (xz - wy) * scale;
  out[at + 3] = 0;
  out[at + 4] = (xy - wz) * scale;
  out[at + 5] = (1 - xx - zz) * scale;
  out[at + 6] = (yz + wx) * scale;
  out[at + 7] = 0;
  out[at + 8] = (xz + wy) * scale;
  out[at + 9] = (yz - wx) * scale;
  out[at + 10] = (1 - xx - yy) * scale;
  out[at + 11] = 0;
  out[at + 12] = x;
  out[at + 13] = y;
  out[at + 14] = z;
  out[at + 15] = 1;
}
