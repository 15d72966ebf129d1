from .errors import (
    PacketError as PacketError,
    PortError as PortError,
    ProtocolError as ProtocolError,
    WriterError as WriterError,
)
