using System;
using System.Collections.Generic;
using System.Linq;
using UnityEngine;

namespace Clothfit
{
    /// <summary>Springs as lines, from blue for the softest over green to red for the stiffest, on a logarithmic scale.</summary>
    public static class SpringColours
    {
        const int Most = 20000; // lines that gizmos draw in good time; of more springs every second, third, … is drawn
        const float LeftOut = 0.05f; // share of the softest, and of the stiffest, that have the colours at the ends

        /// <summary>Draws the springs between pairs of places, m, in the world.</summary>
        public static void Draw(IList<Vector3> places, IList<int> ends, IList<float> stiffness)
        {
            Vector2 range = Range(stiffness);
            int every = 1 + stiffness.Count / Most;
            for (int s = 0; s < stiffness.Count; s += every)
            {
                Gizmos.color = Of(stiffness[s], range);
                Gizmos.DrawLine(places[ends[2 * s]], places[ends[2 * s + 1]]);
            }
        }

        /// <summary>Logarithms of the stiffnesses that have the colours at the ends.</summary>
        public static Vector2 Range(IEnumerable<float> stiffness)
        {
            float[] sorted = stiffness.Where(k => k > 0f).Select(k => (float)Math.Log(k)).OrderBy(k => k).ToArray();
            if (sorted.Length == 0) return Vector2.zero;
            int low = (int)(LeftOut * (sorted.Length - 1));
            return new Vector2(sorted[low], sorted[sorted.Length - 1 - low]);
        }

        /// <summary>The colour of a stiffness, N/m; grey where all are the same.</summary>
        public static Color Of(float stiffness, Vector2 range)
        {
            if (range.y - range.x < 1e-4f) return Color.grey;
            if (stiffness <= 0f) return Color.blue;
            float share = Mathf.Clamp01(((float)Math.Log(stiffness) - range.x) / (range.y - range.x));
            return share < 0.5f ? Color.Lerp(Color.blue, Color.green, 2f * share) : Color.Lerp(Color.green, Color.red, 2f * share - 1f);
        }
    }
}
