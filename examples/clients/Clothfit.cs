// A client of `clothfit serve` in C#, without packages: for .NET and Unity. docs/serve.md has messages and frames.
//
//   using var live = new Clothfit.Client("http://127.0.0.1:8000/?token=…");
//   live.Send("{\"type\":\"play\"}");
//   if (live.Latest(ref positions, out ulong number)) …;  // never waits: copies the newest frame, if there is one

using System;
using System.Collections.Concurrent;
using System.IO;
using System.Net.WebSockets;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Clothfit
{
    /// <summary>A connection to a server. A thread of the pool reads; all methods return at once.</summary>
    public sealed class Client : IDisposable
    {
        const int Header = 24; // bytes before the positions

        readonly ClientWebSocket socket = new ClientWebSocket();
        readonly CancellationTokenSource end = new CancellationTokenSource();
        readonly ConcurrentQueue<string> messages = new ConcurrentQueue<string>();
        readonly BlockingCollection<string> waiting = new BlockingCollection<string>();
        volatile Frame newest;

        sealed class Frame
        {
            public uint Generation;
            public ulong Number;
            public double Time;
            public float[] Positions;
        }

        /// <summary>Why the connection ended, or null.</summary>
        public string Error { get; private set; }

        /// <summary>Connects to the address that `clothfit serve` prints; throws where no server answers.</summary>
        public Client(string address)
        {
            var place = new UriBuilder(address) { Scheme = "ws", Path = "/ws" };
            socket.ConnectAsync(place.Uri, end.Token).GetAwaiter().GetResult();
            Task.Run(Read);
            Task.Run(Write);
        }

        /// <summary>
        /// Copies x, y, z of each vertex, m, of the newest frame into an array, which is made anew where its length does
        /// not fit. False as long as no frame has come.
        /// </summary>
        public bool Latest(ref float[] positions, out ulong number)
        {
            Frame frame = newest;
            number = frame == null ? 0 : frame.Number;
            if (frame == null) return false;
            if (positions == null || positions.Length != frame.Positions.Length) positions = new float[frame.Positions.Length];
            Buffer.BlockCopy(frame.Positions, 0, positions, 0, 4 * positions.Length);
            return true;
        }

        /// <summary>Sends a message, JSON; its answer comes among the messages.</summary>
        public void Send(string json)
        {
            waiting.Add(json);
        }

        /// <summary>Takes the next message of the server, JSON. False where there is none.</summary>
        public bool Message(out string json)
        {
            return messages.TryDequeue(out json);
        }

        public void Dispose()
        {
            end.Cancel();
            waiting.CompleteAdding();
            socket.Dispose();
        }

        async Task Write()
        {
            try
            {
                foreach (string json in waiting.GetConsumingEnumerable(end.Token))
                {
                    var data = new ArraySegment<byte>(Encoding.UTF8.GetBytes(json));
                    await socket.SendAsync(data, WebSocketMessageType.Text, true, end.Token);
                }
            }
            catch (Exception error) { Fail(error); }
        }

        async Task Read()
        {
            var buffer = new ArraySegment<byte>(new byte[1 << 16]);
            var whole = new MemoryStream();
            try
            {
                while (!end.IsCancellationRequested)
                {
                    WebSocketReceiveResult part = await socket.ReceiveAsync(buffer, end.Token);
                    if (part.MessageType == WebSocketMessageType.Close) throw new IOException("the server has ended");
                    whole.Write(buffer.Array, 0, part.Count);
                    if (!part.EndOfMessage) continue;
                    byte[] data = whole.ToArray();
                    whole.SetLength(0);
                    if (part.MessageType == WebSocketMessageType.Text) messages.Enqueue(Encoding.UTF8.GetString(data));
                    else Take(data);
                }
            }
            catch (Exception error) { Fail(error); }
        }

        void Take(byte[] data)
        {
            if (data.Length < Header || Encoding.ASCII.GetString(data, 0, 4) != "CFF1") return; // the target, perhaps
            var frame = new Frame
            {
                Generation = BitConverter.ToUInt32(data, 4), // little-endian, as all processors of today are
                Number = BitConverter.ToUInt64(data, 8),
                Time = BitConverter.ToDouble(data, 16),
                Positions = new float[(data.Length - Header) / 4],
            };
            Buffer.BlockCopy(data, Header, frame.Positions, 0, data.Length - Header);
            newest = frame; // one assignment: nobody sees half of it
        }

        void Fail(Exception error)
        {
            if (!end.IsCancellationRequested) Error = error.Message;
        }
    }
}
