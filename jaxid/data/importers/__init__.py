"""Recordings of others, as datasets: one kind of file a module."""

from typing import NamedTuple


class Importer(NamedTuple):
    """What reads recordings of one kind: its module and function, and the options of `jaxid import`
    that it takes beside `--overwrite`.
    """

    place: str
    options: tuple[str, ...] = ()


#: Each kind by its name. A new one has its file and a line here.
IMPORTERS = {
    "emps": Importer("jaxid.data.importers.emps:import_emps"),
    "ur_rtde_csv": Importer("jaxid.data.importers.robot:import_ur_rtde_csv"),
    "rosbag": Importer(
        "jaxid.data.importers.robot:import_rosbag", ("topic", "command_topic", "command_joints")
    ),
    "mcap": Importer(
        "jaxid.data.importers.robot:import_mcap", ("topic", "command_topic", "command_joints")
    ),
    "lerobot": Importer(
        "jaxid.data.importers.lerobot:import_lerobot", ("unit", "calibration", "ranges")
    ),
}
