using System;
using System.IO;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// Plays a motion, a PC2 point cache as `clothfit simulate -o motion.pc2` writes, on the mesh of a cloth, or as a
    /// ghost beside it.
    /// </summary>
    [AddComponentMenu("Clothfit/Player")]
    [ExecuteAlways]
    public class ClothfitPlayer : ClothfitMover
    {
        [Tooltip("PC2 file, a path in the project folder or absolute")]
        public string motion = "";

        [Tooltip("Frames per second of the file, 1/s; 50 for time steps of 0.02 s")]
        [Min(0.001f)]
        public float frameRate = 50f;

        [Tooltip("Number in the file of the first vertex of this cloth: the vertices of the cloths before it")]
        [Min(0)]
        public int firstVertex;

        [Tooltip("Time that is shown, s; it goes on by itself in play mode")]
        [Min(0f)]
        public float time;

        [Tooltip("Begin again at the end")]
        public bool loop = true;

        [Tooltip("Draw the motion as lines in the scene view and leave the mesh as it is: the ghost of a target")]
        public bool ghost;

        MotionFile file;
        string opened;
        Weld weld;
        Vector3[] places;
        int shown = -1;

        /// <summary>Shows the frame at a time, s.</summary>
        public void Show(float at)
        {
            time = at;
            if (!Open()) return;
            int frame = Mathf.FloorToInt(time * frameRate + 0.001f); // of two frames the one that has begun
            frame = loop ? frame % file.Frames : Mathf.Min(frame, file.Frames - 1);
            if (frame == shown) return;
            try
            {
                file.Read(frame, firstVertex, places);
                shown = frame;
                if (!ghost) Move(weld, places);
            }
            catch (Exception error) when (error is IOException || error is FormatException)
            {
                Refuse(error.Message);
            }
        }

        /// <summary>Closes the file and gives the mesh back as it was.</summary>
        public override void Close()
        {
            if (file != null) file.Dispose();
            file = null;
            opened = Error = null;
            shown = -1;
            base.Close();
        }

        void Update()
        {
            Show(Application.isPlaying ? time + Time.deltaTime : time);
        }

        void OnDrawGizmos()
        {
            if (!ghost || file == null || shown < 0) return;
            Gizmos.color = new Color(0.3f, 1f, 0.4f, 1f);
            int[] corners = weld.Triangles;
            for (int k = 0; k < corners.Length; k++)
            {
                int next = k % 3 == 2 ? k - 2 : k + 1;
                Gizmos.DrawLine(places[corners[k]], places[corners[next]]);
            }
        }

        bool Open()
        {
            string wanted = motion + (ghost ? "|" : "") + firstVertex;
            if (opened == wanted) return file != null;
            Close();
            opened = wanted;
            if (motion.Length == 0) return false;
            try
            {
                weld = Welded();
                places = new Vector3[weld.Places.Length];
                file = new MotionFile(motion);
                return true;
            }
            catch (Exception error) when (error is IOException || error is FormatException || error is UnauthorizedAccessException)
            {
                Refuse(error.Message);
                return false;
            }
        }

        /// <summary>Does not try the same file again.</summary>
        void Refuse(string message)
        {
            string wanted = opened;
            Fail(message);
            opened = wanted;
        }
    }
}
