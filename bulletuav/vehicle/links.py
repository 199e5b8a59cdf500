"""Links of a URDF joined to one rigid body: poses, mass, centre of mass, inertia and shapes.

References:
    R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 2: the parallel-axis theorem.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.rotation import axes, product, to_world
from bulletuav.vehicle.urdf import UrdfFile

MAX_LINKS = 1000
"""Maximum number of links of a file."""
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
"""Quaternion of no rotation."""
FIXED = frozenset({"fixed"})
"""Joint types of a rigid body."""


class PlacedLink(NamedTuple):
    """A link at its pose in the frame of the root link.

    Attributes:
        name: Name of the link.
        element: The `<link>` element.
        joint: Type of the joint to the parent link; empty for the root link.
        joint_name: Name of this joint.
        place: (3,) origin of the link, m.
        quaternion: (4,) rotation from the link's axes to the root's.
    """

    name: str
    element: ElementTree.Element
    joint: str
    joint_name: str
    place: np.ndarray
    quaternion: np.ndarray

    def pose(self, urdf: UrdfFile, element: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose of an element of the link in the frame of the root link.

        Args:
            urdf: The file.
            element: An element with an `<origin>`, such as `<collision>`.

        Returns:
            Position (3,), m, and quaternion (4,).
        """
        place, turn = urdf.origin(element)
        return (
            self.place + to_world(self.quaternion, place),
            np.array(product(self.quaternion, turn)),
        )


class RigidBody(NamedTuple):
    """Mass properties of links that are joined to one body, in the axes of the root link.

    Attributes:
        mass: Mass, kg.
        centre: (3,) centre of mass, m.
        inertia: (3, 3) inertia about the centre of mass, kg m^2.
    """

    mass: float
    centre: np.ndarray
    inertia: np.ndarray


def place_links(urdf: UrdfFile, joints: Collection[str] = FIXED) -> list[PlacedLink]:
    """Compute the pose of each link, with all joints at 0.

    Args:
        urdf: The file.
        joints: Accepted types of joints.

    Returns:
        The links: the root first, each after its parent.

    Raises:
        ValueError: If the links are no tree, a joint has another type, or there are too many links.
    """
    found = urdf.root.findall("link")
    if not 1 <= len(found) <= MAX_LINKS:
        raise urdf.make_error("link", f"{len(found)} links", f"1 to {MAX_LINKS} links are needed")
    links = {link.get("name", ""): link for link in found}
    if len(links) < len(found):
        raise urdf.make_error("link name", "there twice", "each link needs a name of its own")
    children: dict[str, list[ElementTree.Element]] = {name: [] for name in links}
    parented: set[str] = set()
    for joint in urdf.root.findall("joint"):
        parent, child = (_end(urdf, joint, tag, links) for tag in ("parent", "child"))
        if child in parented:
            raise urdf.make_error("joint child", child, "a link has one parent at most")
        if joint.get("type") not in joints and not _is_locked(urdf, joint):
            kind = f"{joint.get('name', 'unnamed')}, type {joint.get('type', 'missing')}"
            reason = (
                f"only joints of type {' or '.join(sorted(joints))} are supported: change the type "
                f"to fixed in a copy of the file, with the wanted angle or shift in its <origin>"
            )
            raise urdf.make_error("joint", kind, reason)
        parented.add(child)
        children[parent].append(joint)
    roots = [name for name in links if name not in parented]
    if len(roots) != 1:
        which = ", ".join(roots[:5]) or "missing"
        raise urdf.make_error("link", which, "exactly one link without a parent is needed")
    placed = [PlacedLink(roots[0], links[roots[0]], "", "", np.zeros(3), UPRIGHT)]
    for link in placed:  # which grows
        for joint in children[link.name]:
            name = _end(urdf, joint, "child", links)
            kind, own = joint.get("type", ""), joint.get("name", "")
            placed.append(PlacedLink(name, links[name], kind, own, *link.pose(urdf, joint)))
    if len(placed) < len(links):
        raise urdf.make_error("joint", "in a circle", "links must form a tree")
    return placed


def _is_locked(urdf: UrdfFile, joint: ElementTree.Element) -> bool:
    """Return True for a joint whose limits leave it at 0, as those of RotorS' sensors do."""
    limit = joint.find("limit")
    return limit is not None and all(
        key in limit.attrib and urdf.number(limit, key) == 0 for key in ("lower", "upper")
    )


def _end(urdf: UrdfFile, joint: ElementTree.Element, tag: str, links: Collection[str]) -> str:
    """Read the name of a joint's parent or child link."""
    element = joint.find(tag)
    name = "" if element is None else element.get("link", "")
    if name not in links:
        raise urdf.make_error(f"joint {tag}", name or "missing", "the name of a link is needed")
    return name


def join_links(
    urdf: UrdfFile, links: list[PlacedLink], enlarged: Mapping[str, float] = MappingProxyType({})
) -> RigidBody:
    """Compute the mass properties of links that are joined to one body.

    The inertia of each link is rotated, R I R^T, and moved, m (|d|^2 E - d d^T).

    Args:
        urdf: The file.
        links: Result of `place_links`.
        enlarged: Factor by which the file enlarges the own inertia of a link, by its name.

    Returns:
        The body.

    Raises:
        ValueError: If a mass or a moment is negative or missing, or the total mass is 0.
    """
    masses, places, tensors = [], [], []
    for link in links:
        inertial = link.element.find("inertial")
        if inertial is None:
            continue
        masses.append(urdf.number(urdf.element("mass", inertial), "value", low=0, strict=False))
        place, turn = link.pose(urdf, inertial)
        rotation = np.array(axes(turn)).T
        places.append(place)
        tensor = _tensor(urdf, urdf.element("inertia", inertial)) / enlarged.get(link.name, 1.0)
        tensors.append(rotation @ tensor @ rotation.T)
    total = float(sum(masses))
    if total <= 0:
        raise urdf.make_error("mass value", total, "the sum over all links must be above 0")
    centre = np.average(places, axis=0, weights=masses)
    inertia = np.zeros((3, 3))
    for mass, place, tensor in zip(masses, places, tensors, strict=True):
        offset = place - centre
        inertia += tensor + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return RigidBody(total, centre, inertia)


def _tensor(urdf: UrdfFile, element: ElementTree.Element) -> np.ndarray:
    """Read an inertia tensor (3, 3), kg m^2; missing products are 0."""
    xx, yy, zz = (urdf.number(element, key, low=0, strict=False) for key in ("ixx", "iyy", "izz"))
    xy, xz, yz = (
        urdf.number(element, key) if key in element.attrib else 0.0 for key in ("ixy", "ixz", "iyz")
    )
    return np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)])
