using System;
using System.IO;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// Plays a network that `clothfit subspace` has trained on the mesh of a cloth: a step at a time, under what acts on
    /// it now. Steps of physics are not computed here; a script may set the coordinates of such a model.
    /// </summary>
    [AddComponentMenu("Clothfit/Subspace player")]
    public class ClothfitSubspacePlayer : ClothfitMover
    {
        const int MostSteps = 4; // in a frame; slower machines fall behind

        [Tooltip("The model, .npz, a path in the project folder or absolute")]
        public string model = "";

        [Tooltip("Number of the cloth in the model's scene, from 0")]
        [Min(0)]
        public int number;

        [Tooltip("Time step of the model's scene, s")]
        [Min(1e-4f)]
        public float timeStep = 0.02f;

        [Tooltip("What acts on a step, in the order of the model: such as the wind's x, y, z, m/s. A script may change it")]
        public float[] signals = new float[0];

        [Tooltip("Ways of the pins since the start, m, in the order of the model. A script may change them")]
        public Vector3[] pins = new Vector3[0];

        Subspace played;
        string opened;
        Weld weld;
        Vector3[] places, directions;
        float behind; // s

        /// <summary>The model that plays; null where there is none, or before the first step.</summary>
        public Subspace Played
        {
            get { return Open() ? played : null; }
        }

        /// <summary>Takes a step and shows where it leads.</summary>
        public void Step()
        {
            if (!Open()) return;
            try
            {
                played.Step(signals);
                Show();
            }
            catch (Exception error) when (error is ArgumentException || error is InvalidOperationException)
            {
                Fail(error.Message);
                played = null;
            }
        }

        /// <summary>Shows the cloth at the model's coordinates.</summary>
        public void Show()
        {
            if (!Open()) return;
            played.Decode(played.Pins > 0 ? Flat(pins, played.Pins) : null);
            played.Shade();
            Take(played.Positions, places);
            Take(played.Normals, directions);
            Move(weld, places, directions);
        }

        void Update()
        {
            if (!Application.isPlaying || !Open()) return;
            behind = Mathf.Min(behind + Time.deltaTime, MostSteps * timeStep);
            for (; behind >= timeStep && played != null; behind -= timeStep) Step();
        }

        bool Open()
        {
            string wanted = model + "|" + number;
            if (opened == wanted) return played != null;
            Close();
            opened = wanted;
            played = null;
            Error = null;
            if (model.Length == 0) return false;
            try
            {
                weld = Welded();
                var found = new Subspace(model, number);
                if (found.Vertices != weld.Places.Length)
                    throw new FormatException(model + ": has " + found.Vertices + " vertices, the mesh has " + weld.Places.Length);
                places = new Vector3[found.Vertices];
                directions = new Vector3[found.Vertices];
                played = found;
            }
            catch (Exception error) when (error is IOException || error is FormatException || error is InvalidDataException
                || error is UnauthorizedAccessException || error is NullReferenceException)
            {
                Fail(error is NullReferenceException ? model + ": has no cloth " + number : error.Message);
            }
            return played != null;
        }

        static float[] Flat(Vector3[] ways, int count)
        {
            var flat = new float[3 * count];
            for (int p = 0; p < Mathf.Min(count, ways.Length); p++)
            {
                flat[3 * p] = ways[p].x;
                flat[3 * p + 1] = ways[p].y;
                flat[3 * p + 2] = ways[p].z;
            }
            return flat;
        }

        static void Take(float[] numbers, Vector3[] into)
        {
            for (int i = 0; i < into.Length; i++) into[i] = new Vector3(numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]);
        }
    }
}
