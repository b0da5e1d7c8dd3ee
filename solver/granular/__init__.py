"""Sand and snow: particles that meet on a background grid."""
