"""What knows no robot: errors, words, progress and deadlines, files that are whole or not there."""
