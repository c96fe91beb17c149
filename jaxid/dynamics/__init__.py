"""What a model is: parameters, mechanisms, effects, and the chain from command to sensor."""
