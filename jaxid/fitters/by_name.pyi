from fitters.by_name import *
