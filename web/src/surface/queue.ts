/** First in, first out. */
export class Queue {
  private items: number[] = [];
  private at = 0;

  push(item: number): void {
    this.items.push(item);
  }

  /** The first item, taken out; undefined when there is none. */
  take(): number | undefined {
    if (this.at < this.items.length) return this.items[this.at++];
    this.items = [];
    this.at = 0;
    return undefined;
  }
}
