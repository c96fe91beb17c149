from fitters.de import *
