"""Reads SQLite files of bags, including those with incomplete QoS profiles."""

from __future__ import annotations

import sys

from rosbags import interfaces
from rosbags.interfaces import Connection
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from hoid_bags.storage.qos_profiles import stored_qos

_NO_DEFINITION = interfaces.MessageDefinition(interfaces.MessageDefinitionFormat.NONE, '')
_TIMES = 'SELECT ifnull(min(timestamp), ?), ifnull(max(timestamp) + 1, 0), count(*) FROM messages'


class SqliteFile(Sqlite3Reader):
    """A .db3 file of any version of rosbag2.

    rosbags refuses a file whose QoS profiles lack an entry.
    """

    def _open(self) -> None:
        assert self.dbconn is not None
        run = self.dbconn.execute
        columns = {name for _, name, *_ in run('PRAGMA table_info(topics)')}
        profiles = 'offered_qos_profiles' if 'offered_qos_profiles' in columns else "''"
        rows = run(
            f'SELECT topics.id, name, type, serialization_format, {profiles}, count(messages.id) '  # noqa: S608 - constants
            'FROM topics LEFT JOIN messages ON topics.id = topic_id GROUP BY topics.id'
        )
        self.connections = [
            Connection(
                topic_id, name, type_name, _NO_DEFINITION, '', number,
                interfaces.ConnectionExtRosbag2(encoding, stored_qos(qos)), self,
            )
            for topic_id, name, type_name, encoding, qos, number in rows
        ]  # fmt: skip
        ((first_ns, end_ns, number),) = run(_TIMES, (sys.maxsize,))
        self.metadata = self.metadata._replace(
            start_time=first_ns, end_time=end_ns, message_count=number
        )
