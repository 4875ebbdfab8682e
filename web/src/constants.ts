/** Numbers that the format fixes: see spec/cndhf.md. */
export const SIGNATURE = [0x89, 0x44, 0x48, 0x46, 0x0d, 0x0a, 0x1a, 0x0a];
export const MAJOR = 0;
export const MINOR = 2;
export const MINOR_DHF = 1;

export const HEADER_SIZE = 40;
export const TABLE_ENTRY_SIZE = 6;
export const RECORD_HEAD_SIZE = 26;
export const CRC_SIZE = 4;

export const OPTIONAL = 0x80;
export const KIND_RECORDS = 0x01;
export const KIND_WEIGHTS = 0x02;
export const KIND_SURFACE = 0x03;
export const KIND_METADATA = 0x81;

export const CODEC_RAW = 0;
export const CODEC_ZSTD = 1;
export const CODEC_RANS = 2;
export const CODEC_RANGE = 3;

export const QUATERNION_ONE = 32767;
export const QUATERNION_MIN_NORM = 32000;
export const QUATERNION_MAX_NORM = 33000;
export const BOX_STEP = 2 ** -14;
export const STEP_WIDE = 0x80;

export const MAX_CENTRE = 2 ** 100;
export const MIN_SCALE = 2 ** -100;
export const MAX_SCALE = 2 ** 100;

export const MAX_FILE_SIZE = 2 ** 24;
export const MAX_SECTIONS = 16;
export const MAX_DHFS = 64;
export const MAX_WIDTH = 128;
export const MAX_HIDDEN_LAYERS = 8;
export const MAX_PARAMETERS = 2 ** 20;
export const MAX_SYMBOL = 32767;
