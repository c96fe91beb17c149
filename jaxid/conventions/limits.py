"""The numbers that the check decides by, where several of its modules share them; each with its
unit and why it is what it is.
"""

#: Share of the gap that a reading may leave to be decisive: by the contract at least 30 % of it
#: goes, of the missing drive, of what remains beside any law of the joints' own motion, and of the
#: simulation's.
GONE = 0.7
#: Ratio of two remainders that cannot be told apart: each is an rms over some fifty stretches of
#: motion, known to 10 %.
ALIKE = 1.15
#: Share of the drive to which the missing force is known at best: what filters and friction near
#: rest leave of a perfect model.
FLOOR = 0.01
#: Share of the gap below which a reading explains it as a whole, and the many readings of the next
#: kind are not gone through.
WHOLE = 0.2
#: Share of the gap that a reading leaves at most to be asked about where laws that the model may
#: lack come near: a reading has no number of its own, so that it does not take two thirds of a gap
#: by being free.
ASKED = 0.3
#: Logarithm of a factor: half of the least distance between two conventions that are not both
#: counts, rpm and turns.
APART = 0.2
#: A size that is known no better than to a factor e, or to a radian, has no interval to state.
TOLD = 1.0
#: Logarithm of a factor by which stated numbers of a model may be off, as masses and gains are.
MISFIT = 0.35
