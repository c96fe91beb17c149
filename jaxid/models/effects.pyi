from models.effects import *
