"""Version of the package, its constants, and its addresses."""

__version__ = "0.9.0"
CONSTANTS = 2
"""Number of the forces, airframes and rewards: another one means that policies learned in others"""

REPOSITORY = "https://github.com/OWNER/bulletuav"
"""Address of the repository; OWNER is a placeholder until the project is published"""
INDEX_NAME = "bulletuav"
"""Name of the project on the package index; a placeholder until the project is published"""
DOCUMENTATION = f"{REPOSITORY}/blob/main/docs/index.md"
"""Address of the documentation"""
