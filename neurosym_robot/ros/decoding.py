"""Messages of ROS 1 deserialised, by the definition that their publisher sends first."""

from collections.abc import Mapping
from typing import Any

from neurosym_robot.ros.definitions import PEOPLE, definitions, ros1_name, typestore
from neurosym_robot.ros.people import KINDS

__all__ = ["Decoder"]

MOST = 64  # definitions that are learned: a publisher may send a new one each time


class Decoder:
    """Reads messages of people of any type in `KINDS`, defined as their publisher defines them.

    A type that we define is refused if its publisher's definition differs. Raises InputError if
    rosbags is not installed.
    """

    def __init__(self):
        self._learned: dict[tuple[str, str], Any] = {}
        self.store = typestore(1)

    def refuse(self, header: Mapping[str, str]) -> str | None:
        """Why messages of a publisher with this header cannot be read, or None."""
        kind, md5 = header.get("type", "").replace("/", "/msg/"), header.get("md5sum", "")
        if kind not in KINDS:
            return f"none of {', '.join(map(ros1_name, KINDS))}"
        if kind in definitions():
            ours = self.store.generate_msgdef(kind, ros_version=1)[1]
            return None if md5 == ours else f"not {ros1_name(kind)} with md5 {ours}"
        if (kind, md5) in self._learned:
            return None
        if len(self._learned) == MOST:
            return "one definition too many"
        from rosbags.typesys import get_types_from_msg

        store = typestore(1)
        try:
            types = get_types_from_msg(header.get("message_definition", ""), kind)
            store.register({name: form for name, form in types.items() if name not in store.types})
            theirs = store.generate_msgdef(kind, ros_version=1)[1]
        except Exception as error:  # The text is not ours and can make the parser raise anything.
            return f"whose definition cannot be read ({type(error).__name__})"
        if theirs != md5:
            return f"whose definition has the md5 {theirs}"
        self._learned[kind, md5] = store
        return None

    def decode(self, data: bytes, header: Mapping[str, str] | None = None) -> tuple[str, Any]:
        """Type, as in `KINDS`, and message; without a header they are `PEOPLE`.

        Raises:
            rosbags.serde.SerdeError: for bytes that are no such message.
        """
        if header is None:
            return PEOPLE, self.store.deserialize_ros1(data, PEOPLE)
        kind = header["type"].replace("/", "/msg/")
        store = self._learned.get((kind, header["md5sum"]), self.store)
        return kind, store.deserialize_ros1(data, kind)
