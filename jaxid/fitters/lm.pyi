from fitters.lm import *
