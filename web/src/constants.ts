/** Numbers that the format fixes: see spec/cndhf.md. An enum, because its members are put in place when it is built. */
export const enum c {
  MAJOR = 0,
  MINOR = 2,
  MINOR_DHF = 1,

  HEADER_SIZE = 40,
  TABLE_ENTRY_SIZE = 6,
  RECORD_HEAD_SIZE = 26,
  CRC_SIZE = 4,

  OPTIONAL = 0x80,
  KIND_RECORDS = 0x01,
  KIND_WEIGHTS = 0x02,
  KIND_SURFACE = 0x03,
  KIND_METADATA = 0x81,

  CODEC_RAW = 0,
  CODEC_ZSTD = 1,
  CODEC_RANS = 2,
  CODEC_RANGE = 3,

  QUATERNION_ONE = 32767,
  QUATERNION_MIN_NORM = 32000,
  QUATERNION_MAX_NORM = 33000,
  BOX_STEP = 2 ** -14,
  STEP_WIDE = 0x80,

  MAX_CENTRE = 2 ** 100,
  MIN_SCALE = 2 ** -100,
  MAX_SCALE = 2 ** 100,

  MAX_FILE_SIZE = 2 ** 24,
  MAX_SECTIONS = 16,
  MAX_DHFS = 64,
  MAX_WIDTH = 128,
  MAX_HIDDEN_LAYERS = 8,
  MAX_PARAMETERS = 2 ** 20,
  MAX_SYMBOL = 32767,
}
