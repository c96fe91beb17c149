"""What ends a recording."""


class HardwareError(RuntimeError):
    """A device, its line or its driver failed while recording; the message is one sentence for a
    person.

    `folder` is set where rows were saved before it happened.
    """

    folder: str | None = None
