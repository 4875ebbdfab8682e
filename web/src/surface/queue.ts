/** First in, first out, of numbers from 0. */
export class Queue {
  private readonly items: number[] = [];
  private at = 0;

  push(item: number): void {
    this.items.push(item);
  }

  /** Takes the first one out; -1 where there is none. */
  take(): number {
    return this.at < this.items.length ? this.items[this.at++]! : -1;
  }
}
