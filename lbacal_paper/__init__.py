"""The paper redone: every quantitative statement judged, every figure redrawn. Read statements, study, then a topic."""
