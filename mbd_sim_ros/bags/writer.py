"""Writer of one bag directory: an MCAP file (profile ros2) with its own description, and a `metadata.yaml`.

While the file is written, its name is `*.mcap.part`. A finished bag has its final name and `metadata.yaml`, so that
`ros2 bag` and `rosbags` open the directory. log_time and publish_time are simulation time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mcap
import yaml
from mcap.exceptions import UnsupportedCompressionError
from mcap.writer import CompressionType, Writer

from mbd_sim_ros.bags.chunks import Message, write_chunk
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import ELEMENTS, TYPE_HASHES, Topic
from solver.disk import atomic_write
from solver.errors import BagError

# Bytes of the three chunks of the same steps together, after which they are written. The time to read a file goes with
# the number of its chunks; with ten times as much, more is lost when a process is killed.
CHUNK_BYTES = 512 * 1024
# topics with a part for every joint, wheel or body
WIDE = ('joint_states', 'reactions', 'tire_states', 'body_motions', 'tf')
PART = '.part'  # ending of the name of an unfinished file
RECORD = 'mbd_sim_ros'  # name of the metadata record that describes the run
# Format of recordings, `format` in that record. It grows by one when a reader of the format before would misread a
# recording.
# A recording without the entry is of mbd_sim_ros 0.1 (format 1). Older formats are read, newer ones are refused
# (records.py).
FORMAT = 2
# media type of attachments with arrays of the scene; their name is their hash (solver.stored)
ARRAYS = 'application/x-mbd-arrays'
RESULT = 'mbd_sim_ros_result'  # name of the metadata record that is written at the end of a run


class BagWriter:
    """Writes one bag directory, synchronously.

    topics: all topics of the bag; a relative name is put under `/`. metadata: record name -> entries. schemas: message
    type -> definition, for types that are not ours. attachments: hash -> arrays that the scene in the metadata names.
    directory: must not exist, or be empty.

    Each chunk holds topics of similar size, so that a reader of small ones need not unpack the large ones. There are
    three kinds: topics of fixed size; topics with a part for every joint, wheel or body; states of elements, which are
    most of a recording. Chunks of the same steps follow each other in this order, so that the inputs of a step stand
    before its results.

    Raises BagError, one sentence, whenever the file system refuses.
    """

    def __init__(
        self,
        directory: str | Path,
        topics: Sequence[Topic],
        metadata: Mapping[str, Mapping[str, str]],
        *,
        schemas: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self.directory = Path(directory)
        self.topics = [topic._replace(name='/' + topic.name.lstrip('/')) for topic in topics]
        self.path = self.directory / f'{self.directory.name}_0.mcap'
        self._counts: dict[int, int] = {}  # messages of every channel so far
        self._waiting: tuple[list[Message], ...] = ([], [], [])  # messages of the next chunk of each kind
        self._size = 0  # bytes of these messages
        self.first_ns: int | None = None
        self.last_ns = 0
        self._custom = {
            key: value
            for key, value in metadata.get(RECORD, {}).items()
            if key in ('scene', 'scene_hash', 'code_version')
        }
        if not hasattr(Writer, 'flush'):
            raise BagError(
                f'mcap {mcap.__version__} writes no recordings, which need flush() of 1.5: python -m pip install '
                "'mcap>=1.5,<1.7'"
            )
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            if any(self.directory.iterdir()):
                raise BagError(
                    f'cannot record into {self.directory}: it is not empty; recordings are never overwritten; choose '
                    'another place'
                )
            self._file = open(str(self.path) + PART, 'xb')  # noqa: SIM115  (closed in finish)
        except OSError as error:
            raise BagError(f'cannot record into {self.directory}: {error.strerror}; choose another place') from error
        try:
            self._start(metadata, schemas or {}, attachments or {})
        except OSError as error:
            self.abandon()
            raise BagError(self._failure(error)) from error

    def _start(
        self, metadata: Mapping[str, Mapping[str, str]], schemas: Mapping[str, str], attachments: Mapping[str, bytes]
    ) -> None:
        for compression in (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE):
            try:
                # Chunks end where flush() ends them, with the heads of all their messages.
                self._writer = Writer(
                    self._file, chunk_size=2 * CHUNK_BYTES, compression=compression, enable_data_crcs=True
                )
                break
            except UnsupportedCompressionError:
                continue
        self._writer.start(profile='ros2', library='mbd_sim_ros')
        # Metadata first: it survives when the process is killed.
        for name, record in metadata.items():
            self._writer.add_metadata(name, dict(record))
        for name, data in attachments.items():
            self._writer.add_attachment(0, 0, name, ARRAYS, data)
        self._channels = []
        known: dict[str, int] = {}
        for topic in self.topics:
            if topic.type not in known:
                text = schemas.get(topic.type) or schema_text(topic.type)
                known[topic.type] = self._writer.register_schema(topic.type, 'ros2msg', text.encode())
            about = {'offered_qos_profiles': yaml.safe_dump([quality_of_service(topic)], sort_keys=False)}
            about['topic_type_hash'] = TYPE_HASHES.get(topic.type, '')
            self._channels.append(self._writer.register_channel(topic.name, 'cdr', known[topic.type], about))
        self._into = [(self._waiting[_weight(t.name)], id) for t, id in zip(self.topics, self._channels, strict=True)]

    def _failure(self, error: OSError) -> str:
        return (
            f'recording to {self.path} failed: {error.strerror or error}; what was written can be recovered from '
            f'{self.path.name}{PART}'
        )

    def write(self, t_ns: int, messages: Iterable[tuple[int, bytes]], published_ns: int | None = None) -> None:
        """Write messages, (index of the topic, encoded message) each, at the simulation time `t_ns` [ns].

        published_ns: publish time [ns], by default `t_ns`.
        """
        if self.first_ns is None:
            self.first_ns = t_ns
        self.first_ns, self.last_ns = min(self.first_ns, t_ns), max(self.last_ns, t_ns)
        published = t_ns if published_ns is None else published_ns
        for index, data in messages:
            waiting, channel = self._into[index]
            waiting.append((channel, t_ns, published, data))
            self._size += len(data)
        if self._size >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the chunks in progress, so that all messages so far can be recovered if the process is killed."""
        try:
            for waiting in self._waiting:
                write_chunk(self._writer, waiting, self._counts)
                waiting.clear()
            self._file.flush()
        except OSError as error:
            raise BagError(self._failure(error)) from error
        self._size = 0

    def finish(self, result: Mapping[str, str] | None = None) -> Path:
        """Complete the bag, give the file its final name, and return the directory. result: entries of the last
        metadata record."""
        try:
            self.flush()
            if result:
                self._writer.add_metadata(RESULT, dict(result))
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(str(self.path) + PART, self.path)
            about = self.directory / 'metadata.yaml'
            with atomic_write(about) as part:
                part.write_text(
                    yaml.safe_dump({'rosbag2_bagfile_information': self._information()}, sort_keys=False),
                    encoding='utf-8',
                )
        except OSError as error:
            self.abandon()
            raise BagError(self._failure(error)) from error
        return self.directory

    @property
    def count(self) -> list[int]:
        """Messages of every topic that have been written."""
        return [self._counts.get(channel, 0) for channel in self._channels]

    def abandon(self) -> None:
        """Close the file as it is; its name still ends in `.part`."""
        try:
            self._file.close()
        except OSError:  # the disk is full: the buffered rest cannot be kept
            os.close(self._file.fileno()) if not self._file.closed else None

    def _information(self) -> dict[str, Any]:
        """Content of metadata.yaml, version 9 of rosbag2 (Jazzy)."""
        start = self.first_ns or 0
        span = {'starting_time': {'nanoseconds_since_epoch': start}, 'duration': {'nanoseconds': self.last_ns - start}}
        total = sum(self.count)
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            'duration': span['duration'].copy(),
            'starting_time': span['starting_time'].copy(),
            'message_count': total,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic.name,
                        'type': topic.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': [quality_of_service(topic)],
                        'type_description_hash': TYPE_HASHES.get(topic.type, ''),
                    },
                    'message_count': count,
                }
                for topic, count in zip(self.topics, self.count)
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self.path.name],
            'files': [{'path': self.path.name, **span, 'message_count': total}],
            'custom_data': self._custom,
            'ros_distro': 'jazzy',
        }


def _weight(topic: str) -> int:
    """Kind of chunk of a topic: 0 for messages of fixed size, 1 if they grow with joints, wheels or bodies, 2 with
    elements."""
    *_, last = words = topic.split('/')
    return 2 if ELEMENTS in words else int(last in WIDE)


def quality_of_service(topic: Topic) -> dict[str, Any]:
    """Quality of service of a topic, in the words of rosbag2."""
    forever = {'sec': 9223372036, 'nsec': 854775807}
    return {
        'history': 'keep_last',
        'depth': topic.depth,
        'reliability': 'reliable' if topic.reliable else 'best_effort',
        'durability': 'transient_local' if topic.latched else 'volatile',
        'deadline': dict(forever),
        'lifespan': dict(forever),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(forever),
        'avoid_ros_namespace_conventions': False,
    }
