"""Every number that the file format fixes. The meaning of each is in spec/cndhf.md."""

from __future__ import annotations

# Made like PNG's: a byte that a 7-bit transfer changes, the name, then CR LF, a DOS end-of-file and LF, which a
# conversion of line endings changes, in either direction.
SIGNATURE = b"\x89DHF\r\n\x1a\n"
MAJOR, MINOR = 0, 2
MINOR_DHF = 1  # the version that a file of double height fields states: nothing in it is newer

# Sizes in bytes.
HEADER_SIZE = 40
TABLE_ENTRY_SIZE = 6
RECORD_HEAD_SIZE = 26
CRC_SIZE = 4

# Section kinds. A decoder skips an unknown kind that has the OPTIONAL bit, and refuses one that has not.
OPTIONAL = 0x80
KIND_RECORDS = 0x01
KIND_WEIGHTS = 0x02
KIND_SURFACE = 0x03
KIND_METADATA = OPTIONAL | 0x01

# Codecs of a section.
CODEC_RAW = 0
CODEC_ZSTD = 1
CODEC_RANS = 2
CODEC_RANGE = 3
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # left out of the file, put back to decompress

# What a DHF does to the solid. Other values are reserved.
ROLE_INTERSECT = 0

# Along which axes a DHF's heights are mirrored in the middle of its box: bit 0 for u, bit 1 for v.
MAX_FOLD = 3

# Fixed-point scales.
QUATERNION_ONE = 32767  # int16 value that stands for 1
QUATERNION_MIN_NORM = 32000  # a rotation's integer quaternion has a norm in this range
QUATERNION_MAX_NORM = 33000
BOX_STEP = 2.0**-14  # box bounds: int16 times this
# Evidence for these constants: ADR 024.
STEPS_PER_OCTAVE = 4  # step code k stands for a quantisation step of 2^(-k / 4)
STEP_CODE_MASK = 0x7F
STEP_WIDE = 0x80  # set on a tensor with two bytes per symbol

# In input units: well beyond any mesh, and well below where float32 and float64 overflow.
MAX_CENTRE = 2.0**100
MIN_SCALE, MAX_SCALE = 2.0**-100, 2.0**100

# Limits. A file that exceeds one is refused before anything is allocated.
MAX_FILE_SIZE = 16 * 2**20
MAX_SECTIONS = 16
MAX_DHFS = 64
MAX_WIDTH = 128
MAX_HIDDEN_LAYERS = 8
MAX_PARAMETERS = 2**20
MAX_SYMBOL = 32767

# Metadata tags; unknown ones are skipped.
TAG_ENCODER = 1
TAG_ERROR = 2
TAG_SOURCE = 3
