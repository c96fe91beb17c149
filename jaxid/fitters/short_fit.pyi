from fitters.short_fit import *
