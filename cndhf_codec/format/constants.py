"""Every number that the file format fixes. The meaning of each is in spec/cndhf.md."""

from __future__ import annotations

# Evidence for the container: ADR 041.
SIGNATURE = b"\x89DHF"  # the first byte does not pass where only text does
VERSION = 1
VERSION_0 = 0x0D  # what files of 0.x, whose signature was longer, have in the version's place

# Sizes in bytes.
FLAGS_AT = 5
FRAME_AT = 6
RECORD_HEAD_SIZE = 25
CRC_SIZE = 4

FAR_CENTRE = 0x01  # flag: the centre is three f64 in place of three f32

# Section kinds. A file has one shape, of one of the first three kinds. A decoder skips an unknown kind that has the
# OPTIONAL bit, and refuses one that has not.
OPTIONAL = 0x80
KIND_ZSTD = 0x01
KIND_RANS = 0x02
KIND_SURFACE = 0x03
KIND_ENCODER = OPTIONAL | 0x01
KIND_ERRORS = OPTIONAL | 0x02
KIND_SOURCE = OPTIONAL | 0x03
SHAPES = (KIND_ZSTD, KIND_RANS, KIND_SURFACE)
METADATA = (KIND_ENCODER, KIND_ERRORS, KIND_SOURCE)

# Codecs of weights: the kinds of their sections.
CODEC_ZSTD = KIND_ZSTD
CODEC_RANS = KIND_RANS
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # left out of the file, put back to decompress
ZSTD_DESCRIPTORS = (0x20, 0x60, 0xA0)  # one segment with its size in 1, 2 or 4 bytes; no checksum, no dictionary

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
MAX_LENGTH_BYTES = 4  # of a section's length
MAX_TEXT = 255  # bytes
MAX_DHFS = 64
MAX_WIDTH = 128
MAX_HIDDEN_LAYERS = 8
MAX_PARAMETERS = 2**20
MAX_SYMBOL = 32767
