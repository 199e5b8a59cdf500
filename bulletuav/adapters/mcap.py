"""Export of recorded flights as MCAP files of ROS 2 messages.

It needs the extra `mcap`, but no ROS installation.
"""

import tempfile
from pathlib import Path

from bulletuav.adapters.flights import FlightArrays, check_flight
from bulletuav.adapters.ros import stamps_of, topics_of
from bulletuav.errors import missing_extra
from bulletuav.files import whole_file

try:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise missing_extra("writing MCAP", "mcap") from None

BAG_VERSION = 8
"""Version of the bag format, that of ROS 2 Jazzy"""


def write_mcap(flight: FlightArrays, path: Path) -> None:
    """Write a recorded flight as one MCAP file.

    Args:
        flight: Arrays of the recording, as `Recording.everything()` returns them.
        path: The file; an existing file is replaced.

    Raises:
        ValueError: If an array is damaged.
        OSError: If the file cannot be written.
    """
    check_flight(flight)
    store = get_typestore(Stores.ROS2_JAZZY)
    topics = topics_of(flight, store.types)
    # The writer creates a folder that contains the file
    with whole_file(path) as part, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        with _writer(bag) as writer:
            connections = [
                writer.add_connection(topic.name, topic.kind, typestore=store) for topic in topics
            ]
            for k, stamp in enumerate(stamps_of(flight)):
                for connection, topic in zip(connections, topics, strict=True):
                    if k in topic.rows:
                        data = store.serialize_cdr(topic.message(k), topic.kind)
                        writer.write(connection, stamp, data)
        (bag / "bag.mcap").replace(part)


def _writer(bag: Path) -> Writer:
    writer = Writer(bag, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    return writer
