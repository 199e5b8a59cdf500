"""`bulletuav convert`: convert a drone's URDF of another simulator into an airframe."""

import argparse

from rich.table import Table

from bulletuav.commands.output import print_files, print_table
from bulletuav.files import replace_file
from bulletuav.vehicle.conversion import convert_urdf

EXAMPLE = """<?xml version="1.0"?>
<robot name="quadrotor">
  <properties kf="3.2e-10" km="8e-12" thrust2weight="2.2" prop_radius="0.023" max_speed_kmh="30"/>
  <link name="base">
    <inertial>
      <mass value="0.03"/>
      <inertia ixx="1.5e-5" iyy="1.5e-5" izz="2.5e-5" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><geometry><cylinder radius="0.06" length="0.025"/></geometry></collision>
  </link>
{rotors}</robot>
"""
"""Example of the form of gym-pybullet-drones; all numbers are our choice"""
ROTOR = """  <link name="prop{k}"/>
  <joint name="joint{k}" type="fixed">
    <parent link="base"/><child link="prop{k}"/><origin xyz="{x} {y} 0"/>
  </joint>
"""
PLACES = ((0.03, -0.03), (-0.03, -0.03), (-0.03, 0.03), (0.03, 0.03))
"""Places of the example's rotors, m"""


def run(arguments: argparse.Namespace) -> None:
    """Convert a file, and print the report; or write the example."""
    if arguments.example is not None:
        if arguments.file is not None or arguments.out is not None:
            raise ValueError("--example converts nothing: leave out FILE and --out")
        rotors = [ROTOR.format(k=k, x=x, y=y) for k, (x, y) in enumerate(PLACES)]
        replace_file(arguments.example, EXAMPLE.format(rotors="".join(rotors)))
        print_files([arguments.example])
        return
    if arguments.file is None or arguments.out is None:
        raise ValueError("FILE and --out NAME.urdf are needed; or --example FILE")
    airframe, entries = convert_urdf(arguments.file, arguments.out)
    table = Table(title=f"airframe {airframe.name}")
    for heading in ("", "name", "value", "origin, or why it is not used"):
        table.add_column(heading)
    for entry in entries:
        table.add_row(*entry)
    print_table(table)
    print_files([arguments.out])
