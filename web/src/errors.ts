/**
 * The errors: whatever this package throws on purpose is a `CndhfError`. `name` says which; the names are those of the
 * Python package. Messages are one line; they name the field, and say what to do when something can be done.
 */
export class CndhfError extends Error {
  override name = "CndhfError";
}

/** Base of the errors down to PayloadError: the bytes are not a valid `.cndhf` file. */
export class FormatError extends CndhfError {
  override name = "FormatError";
}

/** The bytes do not start with the signature: it is another kind of file. */
export class SignatureError extends FormatError {
  override name = "SignatureError";
}

/** The signature shows that the file was transferred as text. */
export class TextModeError extends SignatureError {
  override name = "TextModeError";
}

/** The file has a format version that this decoder does not read. */
export class VersionError extends FormatError {
  override name = "VersionError";
}

/** The file, or a part of it, ends before what it announces. */
export class TruncatedError extends FormatError {
  override name = "TruncatedError";
}

/** The checksum does not match the bytes before it: the file was damaged, or cut short. */
export class ChecksumError extends FormatError {
  override name = "ChecksumError";
}

/** A field of the header, a record, the surface or the metadata holds a value outside its range. */
export class FieldError extends FormatError {
  override name = "FieldError";
}

/** A count or a size is larger than the format allows; thrown before anything of that size is allocated. */
export class LimitError extends FormatError {
  override name = "LimitError";
}

/** A section is missing, repeated, too short, or of an unknown kind. */
export class SectionError extends FormatError {
  override name = "SectionError";
}

/** Compressed data do not decode to what they should. */
export class PayloadError extends FormatError {
  override name = "PayloadError";
}

/** An argument has a wrong type or value. */
export class OptionError extends CndhfError {
  override name = "OptionError";
}

/** No mesh can be made: the solid is empty or too thin for the resolution, or beyond the limits. */
export class SurfaceError extends CndhfError {
  override name = "SurfaceError";
}

/** Something needs an inside, and the file holds a sheet: a surface that encloses nothing. */
export class SheetError extends CndhfError {
  override name = "SheetError";
}
