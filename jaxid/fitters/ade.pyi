from fitters.ade import *
