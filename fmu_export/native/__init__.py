"""The native flavours: C from traced models, compiled into FMUs of FMI 2.0 and 3.0."""
