from fitters.shade import *
