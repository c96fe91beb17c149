from fitters import *
