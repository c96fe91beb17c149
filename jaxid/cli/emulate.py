"""`jaxid emulate`: protocol emulators with a simulated plant behind them."""

from __future__ import annotations

import click

from jaxid.cli.app import Commands


_PLANT = click.option(
    "--plant",
    metavar="FILE",
    help=(
        "TOML or JSON: model, parameters, effects, noise; `ideal` starts at once without any model."
    ),
)
_LOG = click.option(
    "--log",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Write everything that moves to a file.",
)


@click.group(cls=Commands)
def emulate() -> None:
    """Emulate a robot or servo on this computer, to try a recording without hardware.

    Prints its address, then takes orders on standard input, such as `stall 2` or `crc 0.01`; `help`
    lists them, `quit` ends it. Loopback and pseudo terminals only.
    """


@emulate.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="A loopback address.")
@_PLANT
@_LOG
def ur10(host, plant, log) -> int:
    """A UR10 controller: RTDE, dashboard and script ports.

    Behind it are six joints that do not know of each other, each a pendulum by default. Orders:
    drop, malformed, truncated, short, wrong_id, text (each also with `record` or `control`), stall
    SECONDS, mute, speed SHARE, protective_stop, clear.
    """
    from jaxid import runtime
    from jaxid.hardware.emulators.ur import serve

    runtime.prepare()
    serve(host, plant, log)
    return 0


@emulate.command()
@click.option(
    "--id",
    "ids",
    type=click.IntRange(0, 252),
    multiple=True,
    default=(1,),
    show_default=True,
    help="May be repeated.",
)
@click.option(
    "--baud", type=int, default=1_000_000, show_default=True, help="Bits a second on the wire."
)
@click.option(
    "--latency",
    type=click.FloatRange(0, 1),
    default=0.001,
    show_default=True,
    help="Delay of the USB adapter, s.",
)
@click.option(
    "--return-delay",
    type=click.IntRange(0, 254),
    default=250,
    show_default=True,
    help="Register 9, units of 2 us.",
)
@click.option(
    "--seed", type=int, default=0, show_default=True, help="Of the faults that come by chance."
)
@_PLANT
@_LOG
def dynamixel(ids, baud, latency, return_delay, seed, plant, log) -> int:
    """XM430-W350 servos on a pseudo terminal, paced like a wire.

    Orders: silent SHARE, crc SHARE, drop_byte SHARE, late SECONDS [SHARE], noise HEX, latency
    SECONDS, overload [ID], wrap_in SECONDS (of the millisecond counter), unplug.
    """
    from jaxid import runtime
    from jaxid.hardware.emulators.dynamixel import serve

    runtime.prepare()
    serve(list(ids), plant, log, latency=latency, return_delay=return_delay, baud=baud, seed=seed)
    return 0
