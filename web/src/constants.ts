/** Numbers that the format fixes: see spec/cndhf.md. An enum, because its members are put in place when it is built. */
export const enum c {
  VERSION = 1,
  VERSION_0 = 0x0d, // what files of 0.x have in the version's place

  FLAGS_AT = 5,
  FRAME_AT = 6,
  SCALE_AT = 18,
  SCALE_AT_FAR = 30,
  RECORD_HEAD_SIZE = 25,
  CRC_SIZE = 4,

  FAR_CENTRE = 1,

  KIND_ZSTD = 0x01,
  KIND_RANS = 0x02,
  KIND_SURFACE = 0x03,
  OPTIONAL = 0x80,
  KIND_ENCODER = 0x81,
  KIND_ERRORS = 0x82,
  KIND_SOURCE = 0x83,

  QUATERNION_ONE = 32767,
  QUATERNION_MIN_NORM = 32000,
  QUATERNION_MAX_NORM = 33000,
  STEP_WIDE = 0x80,

  MAX_FILE_SIZE = 2 ** 24,
  MAX_SECTIONS = 16,
  MAX_TEXT = 255,
  MAX_DHFS = 64,
  MAX_WIDTH = 128,
  MAX_HIDDEN_LAYERS = 8,
  MAX_PARAMETERS = 2 ** 20,
  MAX_SYMBOL = 32767,
}
