print("nobody can run this")
